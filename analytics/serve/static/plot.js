// A plot by uPlot that can be used by keyboard and read aloud; its values are in a table beside it.
import uPlot from "./uplot/uPlot.esm.js";
import {colour, onTheme} from "./colours.js";
import {ZONE, element, local} from "./texts.js";

const HEIGHT = 340, DAY = 86_400;
const PALETTE = Array.from({length: 8}, (_, i) => `--curve-${i + 1}`);

/** Times of an axis in the zone of the page on 24 hours, as fine as their distance needs; the date where it changes. */
function clock(_plot, splits, _axis, _space, step) {
  let day = "";
  return splits.map(seconds => {
    const {date, time: fine} = local(seconds);
    const time = step >= DAY ? "" : fine.slice(0, step >= 60 ? 5 : step >= 1 ? 8 : 12);
    const shown = date === day ? time : [time, date].filter(Boolean).join("\n");
    day = date;
    return shown;
  });
}

/** Numbers of an axis with as many decimals as tell them apart: uPlot's have three. */
function numbers(plot, splits, axis, _space, step) {
  const isLog = plot.scales[plot.axes[axis].scale].distr === 3;
  let decimals = 0;
  while (decimals < 12 && Math.abs(step * 10 ** decimals - Math.round(step * 10 ** decimals)) > 1e-6 * step * 10 ** decimals) decimals += 1;
  return splits.map(each => (each === null || each === undefined ? "" : isLog || Math.abs(each) >= 1e9 ? String(Number(each.toPrecision(6))) : String(Number(each.toFixed(decimals)) === 0 ? 0 : each.toFixed(decimals))));
}

/** The range of y as uPlot's; values that differ in the last digits of a float alone are one. */
function rounded(_plot, low, high) {
  if (low === null || low === undefined) return [null, null];
  const isOne = high - low <= 1e-12 * Math.max(Math.abs(low), Math.abs(high));
  return uPlot.rangeNum(isOne ? high : low, high, 0.1, true);
}

/**
 * A plot in `host`, `height` pixels high. `options(colours)` gives uPlot's, `label()` says what it shows, `read(i)` the
 * values at point i.
 * Keys: arrows read, those of `keys` do what they say.
 */
export class Plot {
  constructor(host, {options, data, label, read, keys = {}, height = HEIGHT}) {
    this.parts = {options, label, read, keys};
    this.height = height;
    this.data = data;
    this.at = -1;
    this.frame = element("div", {className: "plot", tabIndex: 0, role: "application", "aria-roledescription": "chart"});
    this.reading = element("p", {className: "soft reading", role: "status", "aria-live": "polite"});
    host.append(this.frame, this.reading);
    this.frame.addEventListener("keydown", event => this.#key(event));
    new ResizeObserver(() => this.#fit()).observe(this.frame);
    onTheme(() => this.#draw());
    this.#draw();
  }

  /** Show other data. */
  show(data) {
    this.data = data;
    this.at = -1;
    this.#draw();
  }

  #draw() {
    const ink = colour("--ink"), line = colour("--line");
    const axis = {stroke: ink, grid: {stroke: line, width: 1}, ticks: {stroke: line, width: 1}};
    const given = this.parts.options({ink, line, link: colour("--link"), soft: colour("--soft"), fail: colour("--fail"), pass: colour("--pass"), marginal: colour("--marginal"), palette: PALETTE.map(colour)});
    const axes = (given.axes ?? [{}, {}]).map(each => ({...axis, ...each}));
    const isTime = given.scales?.x?.time !== false;
    if (isTime && !given.axes?.[0]?.values) axes[0] = {space: 90, ...axes[0], values: clock};
    axes.forEach((each, i) => { if (!each.values && !(i === 0 && isTime)) each.values = numbers; });
    const y = given.scales?.y ?? {};
    const scales = {...given.scales, y: y.range || y.distr === 3 ? y : {...y, range: rounded}};
    this.uplot?.destroy();
    const tzDate = seconds => uPlot.tzDate(new Date(seconds * 1e3), ZONE);
    this.uplot = new uPlot({width: this.frame.clientWidth || 600, height: this.height, tzDate, ...given, scales, axes}, this.data, this.frame);
    this.frame.setAttribute("aria-label", this.parts.label());
    this.uplot.over.addEventListener("mousemove", () => this.#read(this.uplot.cursor.idx));
  }

  #fit() {
    const width = this.frame.clientWidth;
    if (width && this.uplot && Math.abs(width - this.uplot.width) > 1) this.uplot.setSize({width, height: this.height});
  }

  #key(event) {
    const last = this.data[0].length - 1;
    const moves = {ArrowLeft: this.at - 1, ArrowRight: this.at + 1, Home: 0, End: last, PageUp: this.at - 50, PageDown: this.at + 50};
    const act = this.parts.keys[event.key];
    if (act) act();
    else if (event.key in moves && last >= 0) this.#read(Math.min(Math.max(moves[event.key], 0), last), true);
    else return;
    event.preventDefault();
  }

  #read(index, moves = false) {
    if (index === null || index === undefined || this.data[0][index] === undefined) return;
    this.at = index;
    this.reading.textContent = this.parts.read(index);
    if (moves) {
      const y = this.data.slice(1).map(values => values[index]).find(value => value !== null && value !== undefined);
      this.uplot.setCursor({left: this.uplot.valToPos(this.data[0][index], "x"), top: y === undefined ? 10 : this.uplot.valToPos(y, "y")}, false);
    }
  }
}
