// The floor: every unit as a cell, coloured by its verdict so far, kept up to date by server-sent events.
import {colour, faint, onTheme} from "./colours.js";
import {ZONE, duration, element, figure, moment, say} from "./texts.js";

const LEAST = 6, MOST = 26, TOLD_MS = 10_000, TABLE_MS = 1000, PAGE_MS = 10_000;
const PARTS = ["floor-alerts", "floor-stations", "floor-table"]; // of the page, which the server writes again
const COLOURS = {"": "--no-data", PASS: "--pass", FAIL: "--fail", MARGINAL: "--marginal", NO_DATA: "--no-data", ABORTED: "--fail"};

/** A verdict as people read it. */
const word = code => say(code || "open");

export function start(section) {
  const floor = new Floor(section);
  const source = new EventSource(section.dataset.live);
  source.addEventListener("floor", event => floor.fill(JSON.parse(event.data)));
  source.addEventListener("change", event => floor.change(JSON.parse(event.data)));
  source.addEventListener("error", () => floor.tell(say(source.readyState === EventSource.CLOSED ? "signed_out" : "away"), true));
}

/** The document at an address, without its scripts; null if it does not come. */
function pageAt(url) {
  return new Promise(resolve => {
    const request = new XMLHttpRequest();
    request.responseType = "document"; // text made a document here is refused by the page's own policy
    request.addEventListener("loadend", () => resolve(request.status === 200 ? request.responseXML : null));
    request.open("GET", url);
    request.send();
  });
}

class Floor {
  constructor(section) {
    this.canvas = element("canvas", {tabIndex: 0, className: "grid", role: "application", "aria-roledescription": "grid"});
    this.reading = element("p", {className: "soft reading", role: "status", "aria-live": "polite"});
    this.live = element("p", {className: "soft"});
    section.querySelector("h2").after(this.canvas, this.reading, this.live);
    this.units = [];   // {number, unit, run, slot, state} in the order of the cells
    this.places = new Map();
    this.#found();
    this.waiting = new Map();
    this.writing = 0;
    this.writtenAt = -PAGE_MS;
    this.timer = 0;
    this.at = -1;
    this.toldAt = 0;
    this.canvas.addEventListener("mousemove", event => this.read(this.#under(event)));
    this.canvas.addEventListener("click", event => this.#open(this.#under(event)));
    this.canvas.addEventListener("keydown", event => this.#key(event));
    new ResizeObserver(() => this.draw()).observe(section);
    onTheme(() => this.draw());
  }

  /** Take all of the floor. */
  fill(found) {
    this.verdicts = found.verdicts;
    this.steps = found.steps;
    this.runs = new Map(found.runs.map(run => [run.run, run]));
    const states = new Map(found.states.map(state => [state[0], state]));
    this.units = found.units.map(([number, unit, run, slot]) => ({number, unit, run, slot, state: states.get(number)}));
    this.#place();
    this.draw();
    this.#tell(found.time_ns);
    if (String(found.version) !== document.getElementById("live-floor").dataset.version) this.#write();
  }

  /** Take what has changed. */
  change(found) {
    for (const [number, name] of Object.entries(found.steps)) this.steps[number] = name;
    for (const run of found.runs) this.runs.set(run.run, run);
    const gone = new Set(found.gone);
    if (found.units.length || gone.size) {
      const fresh = new Map(found.units.map(row => [row[0], row]));
      this.units = this.units.filter(unit => !gone.has(unit.unit) && !gone.has(unit.number) && !fresh.has(unit.number));
      for (const [number, unit, run, slot] of fresh.values()) this.units.push({number, unit, run, slot, state: null});
      this.#place();
      for (const state of found.states) this.#set(state);
      this.draw();
    } else {
      const changed = found.states.map(state => this.#set(state)).filter(at => at !== undefined);
      for (const at of changed) this.#cell(at);
    }
    for (const state of found.states) if (this.rows.has(state[0])) this.waiting.set(state[0], state);
    if (found.runs.length || found.units.length || gone.size) this.#write();
    if (this.waiting.size && !this.timer) this.timer = setTimeout(() => this.#rows(), TABLE_MS);
    this.#tell(found.time_ns);
  }

  /** Say something beside the grid; at once if it is `urgent`. */
  tell(text, urgent = false) {
    this.live.textContent = text;
    if (urgent) this.live.setAttribute("role", "alert"); else this.live.removeAttribute("role");
  }

  draw() {
    const width = this.canvas.parentElement.clientWidth, ratio = devicePixelRatio || 1;
    if (!width || !this.units.length) {
      this.canvas.hidden = !this.units.length;
      return;
    }
    this.canvas.hidden = false;
    this.size = Math.min(MOST, Math.max(LEAST, Math.floor(Math.sqrt((width * 420) / this.units.length))));
    this.columns = Math.max(1, Math.floor(width / this.size));
    const height = Math.ceil(this.units.length / this.columns) * this.size;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.pen = this.canvas.getContext("2d");
    this.pen.scale(ratio, ratio);
    this.inks = Object.fromEntries(Object.entries(COLOURS).map(([verdict, name]) => [verdict, colour(name)]));
    this.inks.focus = colour("--link");
    this.inks.ground = colour("--ground");
    this.units.forEach((_, at) => this.#cell(at));
    this.canvas.setAttribute("aria-label", say("floor", {n: this.units.length}));
  }

  read(at) {
    const unit = this.units[at];
    if (!unit) return;
    const before = this.at;
    this.at = at;
    if (this.units[before]) this.#cell(before);
    this.#cell(at);
    const [, verdict, early, silent, step, left, nearest, last, released] = unit.state ?? [];
    const parts = [unit.unit, word(this.verdicts[verdict]) + (early && !released ? say("early") : ""), unit.slot, unit.run, this.steps[step]];
    if (released) parts.push(say("released"));
    if (silent) parts.push(say("silent"));
    if (nearest !== null && nearest !== undefined) parts.push(say("nearest", {ratio: figure(nearest)}));
    if (left !== null && left !== undefined) parts.push(say("left", {time: duration(left)}));
    if (last) parts.push(this.#moment(last, unit));
    this.reading.textContent = parts.filter(Boolean).join(" · ");
  }

  /** A moment in the time zone of the unit's station. */
  #moment(seconds, unit) {
    return moment(seconds, 0, this.runs.get(unit?.run)?.time_zone ?? ZONE);
  }

  #place() {
    this.units.sort((a, b) => a.run.localeCompare(b.run) || a.number - b.number);
    this.places = new Map(this.units.map((unit, at) => [unit.number, at]));
  }

  /** The rows of the table of units that are shown. */
  #found() {
    this.rows = new Map([...document.querySelectorAll("#floor-units tr[data-number]")].map(row => [+row.dataset.number, row]));
  }

  /** Take the tables from the server again, soon and seldom; not while somebody is in them with the keyboard. */
  #write() {
    if (this.writing) return;
    this.writing = setTimeout(async () => {
      this.writing = 0;
      const parts = PARTS.map(id => document.getElementById(id));
      this.writtenAt = performance.now();
      if (document.hidden || parts.some(part => part.contains(document.activeElement))) return this.#write();
      const page = await pageAt(location.href);
      const fresh = PARTS.map(id => page?.getElementById(id));
      if (!fresh.every(Boolean)) return this.#write();
      parts.forEach((part, i) => part.replaceChildren(...document.importNode(fresh[i], true).childNodes));
      this.#found();
    }, Math.max(TABLE_MS, this.writtenAt + PAGE_MS - performance.now()));
  }

  #set(state) {
    const at = this.places.get(state[0]);
    if (at !== undefined) this.units[at].state = state;
    return at;
  }

  #cell(at) {
    if (!this.pen) return;
    const {state} = this.units[at], size = this.size, x = (at % this.columns) * size, y = Math.floor(at / this.columns) * size;
    const ink = this.inks[this.verdicts[state?.[1] ?? 0]] ?? this.inks[""], pen = this.pen;
    pen.fillStyle = this.inks.ground;
    pen.fillRect(x, y, size, size);
    const isOpen = !state?.[1];
    pen.fillStyle = isOpen ? faint(ink, 0.35) : ink;
    pen.fillRect(x + 1, y + 1, size - 2, size - 2);
    if (state?.[8]) { // released: its slot is free, half of the cell
      pen.fillStyle = this.inks.ground;
      pen.beginPath();
      pen.moveTo(x + size, y);
      pen.lineTo(x + size, y + size);
      pen.lineTo(x, y + size);
      pen.fill();
    }
    if (state?.[3]) { // silent: hollow, so that it is seen without colours
      pen.fillStyle = this.inks.ground;
      pen.fillRect(x + 3, y + 3, size - 6, size - 6);
    }
    if (at === this.at) {
      pen.strokeStyle = this.inks.focus;
      pen.lineWidth = 2;
      pen.strokeRect(x + 1, y + 1, size - 2, size - 2);
    }
  }

  #under(event) {
    const box = this.canvas.getBoundingClientRect();
    const column = Math.floor((event.clientX - box.left) / this.size);
    return column >= this.columns ? -1 : Math.floor((event.clientY - box.top) / this.size) * this.columns + column;
  }

  #open(at) {
    const unit = this.units[at];
    if (unit) location.assign(`/units/${encodeURIComponent(unit.unit)}`);
  }

  #key(event) {
    const moves = {ArrowLeft: -1, ArrowRight: 1, ArrowUp: -this.columns, ArrowDown: this.columns};
    if (event.key === "Enter") this.#open(this.at);
    else if (event.key in moves) this.read(Math.min(Math.max(this.at + moves[event.key], 0), this.units.length - 1));
    else return;
    event.preventDefault();
  }

  /** The rows of the table of units that are shown; once a second, since each change lays out all of the table. */
  #rows() {
    this.timer = 0;
    for (const [number, state] of this.waiting) {
      const row = this.rows.get(number);
      const [verdict, silent, , , , step, ratio, left, last] = row.querySelectorAll("td");
      const code = this.verdicts[state[1]];
      verdict.replaceChildren(element("span", {className: `verdict ${(code || "open").toLowerCase()}`, textContent: word(code)}), state[2] && !state[8] ? say("early") : "");
      silent.textContent = state[8] ? say("released") : state[3] ? say("silent") : "";
      step.textContent = this.steps[state[4]] ?? "";
      ratio.textContent = state[6] === null ? "" : figure(state[6]);
      left.textContent = state[5] === null ? "" : duration(state[5]);
      last.textContent = state[7] ? this.#moment(state[7], this.units[this.places.get(number)]) : "";
    }
    this.waiting.clear();
  }

  #tell(time_ns) {
    const now = performance.now();
    if (now - this.toldAt < TOLD_MS && this.toldAt) return;
    this.toldAt = now;
    const counts = new Map();
    for (const {state} of this.units) {
      const code = this.verdicts[state?.[1] ?? 0];
      counts.set(code, (counts.get(code) ?? 0) + 1);
    }
    const listed = [...counts].map(([code, n]) => say("count", {word: word(code), n})).join(", ");
    this.tell(`${say("live", {time: moment(time_ns / 1e9)})}${listed ? ": " + listed : ""}`);
  }
}
