// A signal from a month to one sample: least and greatest value of each stretch, so that no single sample is lost.
import {Plot} from "./plot.js";
import {faint} from "./colours.js";
import {asked, element, figure, moment, say} from "./texts.js";

const PANEL = 150, POINTS = 1200, FOLLOW_MS = 1000, TABLE_ROWS = 100, SETTLED_MS = 700;
const ns = seconds => (BigInt(Math.round(seconds * 1e6)) * 1000n).toString();

export async function start(section) {
  const host = element("div");
  section.querySelector("h2").after(host);
  const view = new View(section, host);
  await view.show(section.dataset.asked === "all" ? "" : section.dataset.from, section.dataset.asked === "all" ? "" : section.dataset.to, false);
}

/** A page of this server as a document, without running it; null if it is not there. */
function documentAt(url) {
  return new Promise(done => {
    const request = new XMLHttpRequest(); // its documents need no trusted types, which a parser of texts does
    request.open("GET", url);
    request.responseType = "document";
    request.setRequestHeader("Accept", "text/html");
    request.onload = () => done(request.status === 200 ? request.response : null);
    request.onerror = () => done(null);
    request.send();
  });
}

class View {
  constructor(section, host) {
    this.section = section;
    this.host = host;
    this.status = section.querySelector("[role=status]");
    this.boxes = [...document.querySelectorAll("#beside input")];
    this.shown = new Map(); // what is drawn under the signal, by name
    this.panels = element("div", {className: "panels"});
    host.after(this.panels);
    this.chosen = this.boxes.length > 0 && new URL(location.href).searchParams.has("beside");
    for (const box of this.boxes) box.addEventListener("change", () => { this.chosen = true; this.show(...(this.stretch ?? ["", ""])); });
    this.settled = true;
    this.address = location.search;
    addEventListener("popstate", () => location.search === this.address || location.reload()); // not for a fragment
    document.getElementById("signal-form").addEventListener("submit", event => this.#submit(event));
  }

  /** Ask for a stretch and show it; `kept` puts it into the address. */
  async show(from, to, kept = true, quiet = false) {
    clearTimeout(this.following);
    const query = new URLSearchParams({points: POINTS});
    if (from) query.set("from", from);
    if (to) query.set("to", to);
    const beside = this.boxes.filter(box => box.checked), urls = [this.section.dataset.url, ...beside.map(box => box.dataset.url)];
    const mine = this.wanted = [query, ...urls].join(" ");
    this.stretch = [from, to];
    const answers = await Promise.allSettled(urls.map(url => asked(`${url}?${query}`)));
    if (mine !== this.wanted) return; // a later stretch was asked for meanwhile
    if (answers[0].status === "rejected") {
      this.status.textContent = say("failed", {why: answers[0].reason.message});
      return;
    }
    this.found = answers[0].value;
    const others = beside.map((box, i) => ({name: box.value, found: answers[i + 1].value})).filter(each => each.found);
    this.others = others;
    this.over = others.filter(each => each.found.unit_of_measure === this.found.unit_of_measure); // on the same axis
    this.#panels(others.filter(each => !this.over.includes(each)));
    if (kept) {
      const url = stretched(location.href, from, to);
      url.searchParams.delete("beside");
      if (this.chosen) for (const name of beside.length ? beside.map(box => box.value) : ["none"]) url.searchParams.append("beside", name);
      history[this.settled ? "pushState" : "replaceState"](null, "", url); // back leads to where one stayed
      this.settled = false;
      this.address = location.search;
      clearTimeout(this.settling);
      this.settling = setTimeout(() => this.#settle(), SETTLED_MS);
      for (const link of this.section.querySelectorAll(".exports a")) link.href = stretched(link.href, from, to);
    }
    this.#draw(quiet);
    if (kept) requestAnimationFrame(() => setTimeout(() => this.#table())); // the curve is on the screen first
    this.#follow(from, to);
  }

  /** Bring what the page says of the stretch beside the picture: its facts, moments, links and gaps. */
  async #settle() {
    const href = location.href, page = await documentAt(href);
    if (page === null || href !== location.href) return;
    for (const id of ["signal-facts", "signal-zoom", "signal-gaps"]) {
      const found = page.getElementById(id);
      if (found) document.getElementById(id).replaceChildren(...found.childNodes);
    }
    for (const input of document.querySelectorAll("#signal-form [name=from], #signal-form [name=to]")) {
      const found = page.querySelector(`#signal-form [name=${input.name}]`);
      if (found && document.activeElement !== input) input.value = found.value;
    }
    this.settled = true;
  }

  /** Show what comes, while the record goes on and its end is in view. */
  #follow(from, to) {
    const {is_live: live, last_ns: last, to_ns: end} = this.found;
    if (!live || end <= last - 2e9) return;
    const began = performance.now();
    this.following = setTimeout(() => {
      if (document.hidden) return this.#follow(from, to);
      const by = BigInt(Math.round(performance.now() - began)) * 1000000n;
      const moved = at => (at ? (BigInt(at) + by).toString() : at);
      this.show(to ? moved(from) : from, moved(to), false, true);
    }, FOLLOW_MS);
  }

  get span() {
    return [Number(this.found.from_ns) / 1e9, Number(this.found.to_ns) / 1e9];
  }

  /** The stretch that was asked for last, shown or not yet. */
  get wantedSpan() {
    return this.aim ?? this.span;
  }

  zoom(factor, around = 0.5) {
    const [from, to] = this.wantedSpan, length = (to - from) * factor, middle = from + (to - from) * around;
    this.ask(middle - length * around, middle + length * (1 - around));
  }

  move(by) {
    const [from, to] = this.wantedSpan, step = (to - from) * by;
    this.ask(from + step, to + step);
  }

  /** Ask at once; of what is asked for while an answer is on its way only the last is asked, after it. */
  async ask(from, to) {
    if (to - from < 1e-6) return;
    this.aim = [from, to];
    if (this.asking) return;
    this.asking = true;
    try {
      for (let sent = null; this.aim && sent !== this.aim;) {
        sent = this.aim;
        await this.show(ns(sent[0]), ns(sent[1]));
      }
    } finally {
      this.asking = false;
      this.aim = null;
    }
  }

  #all() {
    this.aim = null;
    this.show("", "");
  }

  #columns() {
    const {t_ns, min, max, mean, bucket_ns, gaps} = this.found;
    const columns = [[], [], [], []];
    let next = 0;  // gap
    t_ns.forEach((t, i) => {
      const at = (t + bucket_ns / 2) / 1e9;
      [at, min[i], max[i], mean[i]].forEach((value, column) => columns[column].push(value));
      while (next < gaps.length && gaps[next][0] < t) next += 1;
      if (next < gaps.length && gaps[next][0] < (t_ns[i + 1] ?? Infinity)) [at + 1e-6, null, null, null].forEach((value, column) => columns[column].push(value));
    });
    for (const {found} of this.over) columns.push(beside(columns[0], found));
    return columns;
  }

  #draw(quiet = false) {
    const data = this.#columns(), {unit_of_measure: unit, bucket_ns} = this.found, single = bucket_ns === 0;
    const [from, to] = this.span;
    const options = colours => ({
      scales: {x: {time: true, range: () => [from, to]}},
      cursor: {drag: {x: true, y: false, setScale: false}},
      legend: {show: false},
      series: [
        {},
        {stroke: colours.link, width: 1, points: {show: single && data[0].length < 400}},
        {stroke: colours.link, width: 1, points: {show: false}, show: !single},
        {stroke: colours.ink, width: 1, points: {show: false}, show: !single},
        ...this.over.map((_, i) => ({stroke: colours.palette[(i + 1) % colours.palette.length], width: 1.5, points: {show: false}})),
      ],
      bands: single ? [] : [{series: [2, 1], fill: faint(colours.link, 0.35)}],
      axes: [{}, {label: unit, size: 70}],
      hooks: {setSelect: [plot => this.#selected(plot)]},
    });
    const parts = {
      options, data,
      label: () => say("signal", {signal: this.found.signal, unit, n: this.found.t_ns.length}),
      read: i => this.#reading(i, data),
      keys: {"+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2), 0: () => this.#all(), "[": () => this.move(-0.5), "]": () => this.move(0.5)},
    };
    if (this.plot) {
      Object.assign(this.plot.parts, parts);
      this.plot.show(data);
    } else {
      this.plot = new Plot(this.host, parts);
      this.plot.frame.addEventListener("wheel", event => this.#wheel(event), {passive: false});
      this.plot.frame.addEventListener("dblclick", () => this.#all());
    }
    if (quiet) return; // a screen reader would never end
    const n = this.found.t_ns.length;
    this.status.textContent = n ? `${moment(from, to - from)} – ${moment(to, to - from)}: ${figure(Math.min(...this.found.min))} – ${figure(Math.max(...this.found.max))} ${unit}` : say("none");
  }

  #reading(i, data) {
    const [from, to] = this.span, time = moment(data[0][i], to - from), unit = this.found.unit_of_measure;
    if (this.found.bucket_ns === 0) return say("sample", {time, value: figure(data[1][i]), unit});
    return say("bucket", {time, lo: figure(data[1][i]), hi: figure(data[2][i]), mean: figure(data[3][i]), unit});
  }

  #selected(plot) {
    const {left, width} = plot.select;
    if (width > 3) this.ask(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
    if (width) plot.setSelect({left: 0, top: 0, width: 0, height: 0}, false);
  }

  #wheel(event) {
    if (!event.ctrlKey && !event.shiftKey) return; // the page scrolls
    event.preventDefault();
    const plot = this.plot.uplot, around = (event.clientX - plot.over.getBoundingClientRect().left) / plot.over.clientWidth;
    this.zoom(event.deltaY < 0 ? 0.5 : 2, Math.min(Math.max(around, 0), 1));
  }

  #table() {
    const body = document.querySelector("#signal-buckets tbody"), {t_ns, min, max, mean, n} = this.found;
    const step = Math.max(1, Math.ceil(t_ns.length / TABLE_ROWS)), rows = [];
    for (let i = 0; i < t_ns.length; i += step) {
      const to = Math.min(i + step, t_ns.length), part = values => values.slice(i, to);
      const count = part(n).reduce((a, b) => a + b, 0);
      const average = part(mean).reduce((a, value, k) => a + value * n[i + k], 0) / count;
      const middle = (t_ns[i] + t_ns[to - 1]) / 2e9, extra = this.others.map(each => figure(beside([middle], each.found)[0]));
      const cells = [figure(Math.min(...part(min))), figure(Math.max(...part(max))), figure(average), count, ...extra];
      rows.push(element("tr", {}, element("td", {textContent: moment(t_ns[i] / 1e9, 1)}), ...cells.map(text => element("td", {className: "number", textContent: text}))));
    }
    body.replaceChildren(...rows);
    const head = document.querySelector("#signal-buckets thead tr");
    for (const cell of head.querySelectorAll(".beside")) cell.remove();
    head.append(...this.others.map(each => element("th", {scope: "col", className: "beside", textContent: `${each.name} / ${each.found.unit_of_measure}`})));
  }

  /** Signals of other units of measure, each in a plot of its own under this one, over the same stretch. */
  #panels(others) {
    for (const [name, {host}] of this.shown) if (!others.some(each => each.name === name)) { host.remove(); this.shown.delete(name); }
    const [from, to] = this.span;
    for (const {name, found} of others) {
      const times = found.t_ns.map(t => (t + found.bucket_ns / 2) / 1e9), single = found.bucket_ns === 0;
      const data = [times, found.min, found.max, found.mean];
      const parts = {
        options: colours => ({
          scales: {x: {time: true, range: () => [from, to]}}, legend: {show: false}, cursor: {drag: {x: false, y: false}},
          series: [{}, ...[0, 1].map(() => ({stroke: faint(colours.palette[1], 0.5), width: 1, points: {show: false}, show: !single})), {stroke: colours.palette[1], width: 1.5, points: {show: single && times.length < 400}}],
          bands: single ? [] : [{series: [2, 1], fill: faint(colours.palette[1], 0.25)}],
          axes: [{}, {label: found.unit_of_measure, size: 70, space: 22}],
        }),
        label: () => say("signal", {signal: name, unit: found.unit_of_measure, n: times.length}),
        read: i => say("bucket", {time: moment(times[i], to - from), lo: figure(found.min[i]), hi: figure(found.max[i]), mean: figure(found.mean[i]), unit: found.unit_of_measure}),
      };
      const before = this.shown.get(name);
      if (before) {
        Object.assign(before.plot.parts, parts);
        before.plot.show(data);
        continue;
      }
      const host = element("div", {}, element("h3", {}, element("a", {href: pageOf(found), textContent: name}), ` / ${found.unit_of_measure}`));
      this.panels.append(host);
      this.shown.set(name, {host, plot: new Plot(host, {data, height: PANEL, ...parts})});
    }
    const legend = this.over.length ? [this.found.signal, ...this.over.map(each => each.name)] : [];
    this.names?.remove();
    this.names = element("ul", {className: "legend"}, ...legend.map((name, i) => {
      const swatch = element("span", {className: "swatch"});
      swatch.style.borderColor = `var(--curve-${i + 1})`;
      return element("li", {}, swatch, name);
    }));
    this.panels.before(this.names);
  }

  #submit(event) {
    const {from, to} = event.currentTarget.elements;
    if (from.value.trim() || to.value.trim()) return; // the server reads times in the zone of the page
    event.preventDefault();
    this.aim = null;
    this.show("", "");
  }
}

/** An address with another stretch; without one it is the whole record. */
function stretched(address, from, to) {
  const url = new URL(address);
  for (const [name, value] of [["from", from], ["to", to]]) if (value) url.searchParams.set(name, value); else url.searchParams.delete(name);
  return url;
}

function pageOf(found) {
  return `/signals/${[found.unit, found.run, found.signal].map(encodeURIComponent).join("/")}`;
}

/** Means of another signal at the times of this one: of the last stretch that began before. */
function beside(times, other) {
  let i = -1;
  return times.map(time => {
    while (i + 1 < other.t_ns.length && other.t_ns[i + 1] / 1e9 <= time) i += 1;
    return i < 0 ? null : other.mean[i];
  });
}
