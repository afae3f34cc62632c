// The time line of a run: what was commanded and what the instruments measured, kept up to date while the run goes on.
import uPlot from "./uplot/uPlot.esm.js";
import {Plot} from "./plot.js";
import {faint} from "./colours.js";
import {asked, duration, element, figure, moment, say, trouble} from "./texts.js";
import {words} from "./run_words.js";

const POINTS = 500, FOLLOW_MS = 2000, LOOK_AGAIN_MS = 15000, NS = 1e9;
const PANELS = [
  {name: "temperature", word: "temperature_command_deg_c", units: {degC: 1}},
  {name: "rate", word: "rate_command_deg_per_s", units: {"deg/s": 1, "deg/h": 1 / 3600}},
];
const either = row => (document.documentElement.lang.startsWith("zh") && row.text_zh ? row.text_zh : row.text);

export async function start(section) {
  const line = new TimeLine(section);
  await line.refresh();
}

class TimeLine {
  constructor(section) {
    this.section = section;
    this.hosts = element("div");
    section.querySelector("h2").after(this.hosts);
    this.plots = new Map();
    this.signals = new Map(); // the last answer for each signal
    this.section.addEventListener("refresh", () => this.refresh());
  }

  async refresh() {
    clearTimeout(this.timer);
    let course;
    try {
      course = await asked(this.section.dataset.url);
      await this.#measure(course);
    } catch (error) {
      document.getElementById("course-trouble").textContent = trouble(error);
      this.#again(true);
      return;
    }
    document.getElementById("course-trouble").textContent = "";
    for (const panel of PANELS) this.#draw(panel, course);
    this.#tables(course);
    const wasLive = this.section.dataset.live === "yes";
    this.section.dataset.live = course.is_live ? "yes" : "no";
    this.section.dataset.drawn = String(Date.now());
    this.#again(course.is_live || wasLive, course.outcome === "open");
  }

  /** Looks again soon while a station is at work, and slowly until the run has ended: it may go on. */
  #again(is_live, is_open = true) {
    if (!is_live && !is_open) return;
    const wait_ms = is_live ? FOLLOW_MS : LOOK_AGAIN_MS;
    this.timer = setTimeout(() => (document.hidden ? this.#again(is_live, is_open) : this.refresh()), wait_ms);
  }

  /** Means and extremes of every instrument's signal. */
  async #measure(course) {
    const base = `/api/signals/`, run = encodeURIComponent(course.run);
    await Promise.all(course.measured.map(async each => {
      const url = `${base}${encodeURIComponent(each.instrument)}/${run}/${encodeURIComponent(each.signal)}?points=${POINTS}`;
      try {
        this.signals.set(`${each.instrument} ${each.signal}`, await asked(url));
      } catch { /* nothing has come of it yet */ }
    }));
  }

  #draw(panel, course) {
    const steps = course.steps.filter(step => step.words[panel.word] !== undefined && step.words[panel.word] !== null);
    const found = [...this.signals].filter(([, each]) => each.unit_of_measure in panel.units && each.t_ns.length);
    if (!steps.length && !found.length) return;
    const now = Math.max(0, ...found.map(([, each]) => each.last_ns), ...course.steps.map(step => step.t_end_ns ?? step.t_start_ns)) / NS;
    const tables = [commanded(steps, panel.word, now), ...found.map(([, each]) => measured(each, panel.units[each.unit_of_measure], course.gaps))];
    const data = uPlot.join(tables.map(table => table.length ? table : [[now], [null]]));
    const names = [say("commanded"), ...found.map(([name]) => name)];
    const current = course.steps.filter(step => step.is_current).map(step => [step.t_start_ns / NS, Math.max(now, step.t_start_ns / NS)]);
    const gaps = course.gaps.map(gap => [gap.from_ns / NS, gap.to_ns / NS]);
    const parts = {
      data,
      options: colours => {
        const inks = [colours.link, colours.pass, colours.marginal, colours.soft];
        return {
          scales: {x: {time: true}},
          legend: {show: true, live: false},
          series: [
            {}, {label: names[0], stroke: colours.ink, width: 2, dash: [6, 4], points: {show: false}},
            ...found.map(([name], i) => ({label: name, stroke: inks[i % inks.length], width: 1.5, points: {show: false}})),
          ],
          axes: [{}, {label: say(panel.name), size: 70}],
          hooks: {drawClear: [plot => {
            shade(plot, gaps, faint(colours.fail, 0.2));
            shade(plot, current, faint(colours.link, 0.15));
          }]},
        };
      },
      label: () => say("course", {what: say(panel.name)}),
      read: i => say("at", {
        time: moment(data[0][i]),
        values: names.map((name, k) => [name, latest(data[k + 1], i)]).filter(pair => pair[1] !== null).map(([name, value]) => `${name} ${figure(value)}`).join(", "),
      }),
    };
    const plot = this.plots.get(panel.name);
    if (plot) {
      Object.assign(plot.parts, parts);
      const at = plot.at;
      plot.show(data);
      plot.at = Math.min(at, data[0].length - 1);
      return;
    }
    const host = element("div", {id: `time-line-${panel.name}`});
    this.hosts.append(host);
    this.plots.set(panel.name, new Plot(host, parts));
  }

  /** The rows beside the plots: steps, commands, notes, what the station does. */
  #tables(course) {
    const head = document.querySelectorAll("#run-steps thead th").length;
    const rows = course.steps.map(step => {
        const told = step.words;
      const row = element("tr", {}, ...[
        told.step, told.procedure, told.repeat, told.position, told.axis, told.phase, number(told.rate_command_deg_per_s),
        number(told.temperature_command_deg_c), course.date_known ? moment(step.t_start_ns / NS) : "",
        step.t_end_ns ? duration((step.t_end_ns - step.t_start_ns) / NS) : "", step.units,
        step.is_current ? say("current") : words(step.outcome),
      ].slice(0, head).map(text => element("td", {textContent: text ?? ""})));
      if (step.is_current) row.setAttribute("aria-current", "step");
      return row;
    });
    if (this.section.dataset.live === "yes" || course.is_live) fill("#run-steps", rows, "#no-steps");
    fill("#run-commands", course.commands.map(row => element("tr", {},
      element("td", {textContent: moment(row.given_ns / NS)}), element("th", {scope: "row", textContent: words(row.action)}),
      ...[row.by, row.reason, row.text ? `${words(row.outcome)}: ${either(row)}` : words(row.outcome)].map(text => element("td", {textContent: text})),
    )));
    const notes = document.getElementById("run-notes");
    notes.replaceChildren(...[...course.notes].reverse().map(note => element("li", {},
      course.date_known ? `${moment(note.t_ns / NS)} ` : "", note.unit ? `${note.unit} ` : "", element("b", {textContent: note.author}), ` ${note.text}`)));
    const table = document.getElementById("run-alerts"), shown = new Set([...table.querySelectorAll("tr[data-alert]")].map(row => row.dataset.alert));
    for (const alert of [...course.alerts].reverse().filter(each => !shown.has(each.id))) {
      const cells = [moment(alert.raised_ns / NS), words(alert.severity)].map(text => element("td", {textContent: text}));
      const row = element("tr", {}, ...cells, element("th", {scope: "row", textContent: either(alert)}), element("td"), element("td", {textContent: alert.acknowledged_by}));
      row.dataset.alert = alert.id;
      table.tBodies[0].prepend(row);
      table.hidden = false;
      document.getElementById("no-alerts").hidden = true;
    }
    this.#progress(course);
  }

  #progress({progress, is_live, outcome}) {
    const line = document.getElementById("run-progress");
    if (!is_live || !progress) {
      if (outcome !== "open" && this.section.dataset.live === "yes") location.reload();
      return;
    }
    const condition = words(progress.condition);
    const left = progress.left_s === null ? "" : `, ${say("left", {time: duration(progress.left_s)})}`;
    const text = `${condition}: ${progress.step} / ${progress.steps} ${words(progress.doing)}${left}`;
    line.setAttribute("aria-live", condition === this.condition ? "off" : "polite"); // only a change is told
    this.condition = condition;
    line.textContent = text;
  }
}

function number(value) {
  return value === undefined || value === null ? "" : figure(value);
}

/** Two points a step, and a break where the next one does not follow at once. */
function commanded(steps, word, now) {
  const times = [], values = [];
  for (const step of steps) {
    const from = step.t_start_ns / NS, to = step.t_end_ns ? step.t_end_ns / NS : Math.max(now, from);
    if (times.length && from <= times.at(-1)) continue; // another group of units
    if (times.length) times.push((times.at(-1) + from) / 2), values.push(null);
    times.push(from, Math.max(to, from + 1e-3));
    values.push(step.words[word], step.words[word]);
  }
  return times.length ? [times, values] : [];
}

/** Means of the stretches, with breaks where nothing was measured. */
function measured(found, factor, gaps) {
  const times = [], values = [], half = found.bucket_ns / 2;
  let last = null;
  found.t_ns.forEach((t, i) => {
    const at = (t + half) / NS;
    if (last !== null && gaps.some(gap => gap.from_ns >= last && gap.to_ns <= t + found.bucket_ns)) times.push((times.at(-1) + at) / 2), values.push(null);
    times.push(at);
    values.push(found.mean[i] * factor);
    last = t;
  });
  return times.length ? [times, values] : [];
}

/** The value at a point, else the last one before it; null in a break. */
function latest(values, i) {
  while (i > 0 && values[i] === undefined) i -= 1;
  return values[i] ?? null;
}

function shade(plot, stretches, ink) {
  const {ctx, bbox} = plot;
  ctx.save();
  ctx.fillStyle = ink;
  for (const [from, to] of stretches) {
    const left = Math.max(plot.valToPos(from, "x", true), bbox.left), right = Math.min(plot.valToPos(to, "x", true), bbox.left + bbox.width);
    if (right >= left) ctx.fillRect(left, bbox.top, Math.max(right - left, 2), bbox.height);
  }
  ctx.restore();
}

function fill(selector, rows, none = null) {
  const table = document.querySelector(selector);
  table.tBodies[0].replaceChildren(...rows);
  table.hidden = !rows.length;
  if (none) document.querySelector(none).hidden = rows.length > 0;
}
