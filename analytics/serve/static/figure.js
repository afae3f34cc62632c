// Pictures as data (analytics/plots/picture.py): curves with bounds, limits, marks, a legend, and links behind points.
import uPlot from "./uplot/uPlot.esm.js";
import {Plot} from "./plot.js";
import {colour, faint, onTheme} from "./colours.js";
import {LANG, asked, element, figure, moment, say} from "./texts.js";

const ALIKE = 1e-9; // of a number: nearer ones are the same, computed otherwise or set apart by distinct()
const LEVELS = {limit: "fail", control: "marginal", centre: "ink"}; // with their colours
const DASHES = [[], [7, 4], [2, 3]], CURVES = 8, TOLD = 5, MANY = 60, DAY_S = 86_400;

export async function start(section) {
  const url = section.dataset.figure, status = section.querySelector("[role=status]");
  try {
    draw(section, await asked(url), Number(section.dataset.height) || undefined);
  } catch (error) {
    if (status) status.textContent = error.message;
  }
}

/** Draw a picture at the begin of `host`. */
export function draw(host, picture, height = 300) {
  const {x, y, marks = []} = picture;
  const isLevel = curve => curve.style in LEVELS;
  const curves = picture.curves.filter(curve => !isLevel(curve)), limits = picture.curves.filter(isLevel);
  if (!curves.some(curve => curve.x.length)) return;
  const frame = element("div", {className: "figure"});
  host.prepend(frame);
  const tables = curves.map(curve => sorted(curve));
  const data = uPlot.join(tables.map(table => [table.x, table.y]));
  const places = tables.map(table => new Map(table.x.map((at, i) => [at, i])));
  const log = axis => (axis.scale === "log" ? {distr: 3} : {});
  const low = [], high = [];
  for (const {y: values, lo, hi} of picture.curves) for (const [from, to] of [[low, lo ?? values], [high, hi ?? values], [low, values], [high, values]]) {
    for (const value of to) if (value !== null && (y.scale !== "log" || value > 0)) from.push(value);
  }
  const span = [low.reduce((a, b) => Math.min(a, b), Infinity), high.reduce((a, b) => Math.max(a, b), -Infinity)];
  const ends = around(data[0][0], data[0].at(-1), x);
  const bars = curves.some(curve => curve.style === "bars");
  const isDotted = curve => curve.style === "points" || curve.style === "alarm";
  const ink = (colours, i) => (curves[i].style === "alarm" ? colours.fail : colours.palette[i % CURVES]), dash = i => DASHES[Math.floor(i / CURVES) % DASHES.length];
  const options = colours => ({
    scales: {x: {time: x.scale === "time", ...log(x), range: () => ends}, y: {...log(y), range: () => room(...span, y.scale, bars)}},
    legend: {show: false},
    cursor: {drag: {x: false, y: false}},
    series: [{}, ...curves.map((curve, i) => ({
      stroke: isDotted(curve) ? "transparent" : ink(colours, i), width: isDotted(curve) ? 0 : 1.5, dash: dash(i), spanGaps: true,
      fill: curve.style === "bars" ? faint(ink(colours, i), 0.4) : undefined,
      paths: curve.style === "bars" ? uPlot.paths.bars({size: [0.6, 70]}) : undefined,
      points: {show: isDotted(curve) || curve.style === "both", size: curve.style === "alarm" ? 10 : 6, stroke: ink(colours, i), fill: ink(colours, i)},
    }))],
    axes: [
      x.scale === "names" ? {values: (_, splits) => splits.map(at => (Number.isInteger(at) ? x.names[at]?.[LANG] ?? "" : "")), splits: () => x.names.map((_, i) => i), space: 40} : {label: x.scale === "time" ? undefined : titled(x), space: x.scale === "time" ? 90 : x.scale === "log" ? 50 : 80},
      {label: y.unit && y.label[LANG] === picture.title[LANG] ? y.unit : titled(y), size: 70},
    ],
    hooks: {draw: [plot => overlay(plot, {colours, tables, curves, limits, marks, ink})], ready: [plot => plot.over.addEventListener("click", () => open(plot.cursor))]},
  });
  const open = cursor => {
    const at = nearest(cursor.idx, cursor.top);
    if (at?.link) location.assign(at.link);
  };
  /** The point of a curve at an index that is nearest to a height in pixels. */
  const nearest = (index, top) => {
    const found = curves.map((curve, i) => {
      const place = places[i].get(data[0][index]);
      return place === undefined || tables[i].y[place] === null ? null : {link: tables[i].links?.[place], away: Math.abs(plot.uplot.valToPos(tables[i].y[place], "y") - (top ?? 0))};
    }).filter(Boolean);
    return found.sort((a, b) => a.away - b.away)[0];
  };
  const place = at => (x.scale === "time" ? moment(at) : x.scale === "names" ? x.names[at][LANG] : `${figure(at)} ${x.unit}`.trim());
  const read = index => {
    const told = curves.flatMap((curve, i) => {
      const of = tables[i], at = places[i].get(data[0][index]);
      if (at === undefined || of.y[at] === null) return [];
      const bounds = of.lo?.[at] === null || !of.lo ? "" : say("bounds", {lo: figure(of.lo[at]), hi: figure(of.hi[at])});
      const name = curves.length > 1 ? curve.name[LANG] : "";
      return [[name, of.texts?.[at], of.verdicts?.[at] && say(of.verdicts[at]), `${figure(of.y[at])}${bounds} ${y.unit}`].filter(Boolean).join(" · ")];
    });
    const rest = told.length > TOLD ? [say("more", {n: told.length - TOLD})] : [];
    return `${place(data[0][index])}: ${[...told.slice(0, TOLD), ...rest].join("; ")}`;
  };
  const keys = {Enter: () => { if (plot.at >= 0) open({idx: plot.at}); }};
  const plot = new Plot(frame, {options, data, height, label: () => say("figure", {title: picture.title[LANG], n: curves.length}), read, keys});
  legend(frame, picture, curves, limits);
}

/** A curve in the order of its x. */
function sorted(curve) {
  const order = curve.x.map((_, i) => i).sort((a, b) => curve.x[a] - curve.x[b]);
  const of = values => (values ? order.map(i => values[i]) : null);
  return {x: distinct(of(curve.x)), y: of(curve.y), lo: of(curve.lo), hi: of(curve.hi), texts: of(curve.texts), links: of(curve.links), verdicts: of(curve.verdicts)};
}

/** Values of x that are the same, as those of one moment, a little apart. */
function distinct(x) {
  const step = Math.max(Math.abs(x[0] ?? 0), Math.abs(x.at(-1) ?? 0), 1e-9) * 1e-12;
  for (let i = 1; i < x.length; i += 1) if (x[i] <= x[i - 1]) x[i] = x[i - 1] + step;
  return x;
}

function titled(axis) {
  return axis.unit ? `${axis.label[LANG]} / ${axis.unit}` : axis.label[LANG];
}

/** Room at both ends of the x axis, so that no point is cut. */
function around(from, to, axis) {
  if (axis.scale === "log") return [10 ** Math.floor(Math.log10(from) + 1e-9), 10 ** Math.ceil(Math.log10(to) - 1e-9)];
  if (axis.scale === "names") return [-0.6, Math.max(axis.names.length - 0.4, 0.6)];
  const edge = differ(from, to) ? (to - from) * 0.03 : axis.scale === "time" ? DAY_S / 2 : Math.max(Math.abs(from) * 0.1, 1);
  return [from - edge, to + edge];
}

function differ(from, to) {
  return to - from > ALIKE * Math.max(Math.abs(from), Math.abs(to));
}

function room(from, to, scale, bars) {
  if (scale === "log") return [10 ** Math.floor(Math.log10(from)), 10 ** Math.ceil(Math.log10(to))];
  if (bars) return [Math.min(0, from), to > 0 ? to * 1.08 : 1];
  const edge = differ(from, to) ? (to - from) * 0.08 : Math.max(Math.abs(to) * 0.1, 1e-12);
  return [from - edge, to + edge];
}

/** What uPlot has not: bounds of points, limits over the whole width, marks. */
function overlay(plot, {colours, tables, curves, limits, marks, ink}) {
  const {ctx: pen, bbox: box} = plot, ratio = devicePixelRatio || 1;
  const across = value => plot.valToPos(value, "x", true), up = value => plot.valToPos(value, "y", true);
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top, box.width, box.height);
  pen.clip();
  pen.lineWidth = ratio;
  const many = tables.reduce((sum, table) => sum + table.x.length, 0) > MANY;
  tables.forEach((table, i) => {
    if (!table.lo) return;
    pen.strokeStyle = curves[i].style === "bars" ? colours.ink : faint(ink(colours, i), many ? 0.4 : 0.8);
    const cap = 3 * ratio, floor = plot.scales.y.distr === 3 ? plot.scales.y.min : -Infinity;
    table.x.forEach((at, k) => {
      if (table.lo[k] === null || table.hi[k] === null || table.y[k] === null) return;
      const x = across(at), from = up(Math.max(table.lo[k], floor)), to = up(table.hi[k]);
      stroke(pen, [[x, from], [x, to]]);
      stroke(pen, [[x - cap, from], [x + cap, from]]);
      stroke(pen, [[x - cap, to], [x + cap, to]]);
    });
  });
  pen.lineWidth = 1.5 * ratio;
  for (const limit of limits) {
    pen.strokeStyle = colours[LEVELS[limit.style]];
    pen.setLineDash(limit.style === "centre" ? [] : [6 * ratio, 4 * ratio]);
    // to the edge where it holds for the first or last value, else a little beyond those for which it holds
    const first = plot.data[0][0], last = plot.data[0].at(-1), reach = 8 * ratio;
    const begin = limit.x[0] <= first ? box.left : across(limit.x[0]) - reach;
    const end = limit.x.at(-1) >= last ? box.left + box.width : across(limit.x.at(-1)) + reach;
    const path = [[begin, up(limit.y[0])]];
    limit.x.forEach((at, i) => {
      if (i && limit.y[i] !== limit.y[i - 1]) path.push([across(at), up(limit.y[i - 1])], [across(at), up(limit.y[i])]);
    });
    stroke(pen, [...path, [end, up(limit.y.at(-1))]]);
  }
  pen.setLineDash([2 * ratio, 3 * ratio]);
  pen.strokeStyle = pen.fillStyle = colours.marginal;
  pen.font = `${12 * ratio}px sans-serif`;
  marks.forEach((mark, i) => {
    const x = across(mark.x), text = mark.label[LANG], wide = pen.measureText(text).width;
    stroke(pen, [[x, box.top], [x, box.top + box.height]]);
    const right = x + wide + 6 * ratio < box.left + box.width;
    pen.fillText(text, right ? x + 4 * ratio : Math.max(x - wide - 4 * ratio, box.left), box.top + (14 + 14 * (i % 3)) * ratio);
  });
  pen.restore();
}

function stroke(pen, path) {
  pen.beginPath();
  path.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
}

/** Names of the curves with their colours, where there are several; of limits always. */
function legend(frame, picture, curves, limits) {
  if (curves.length + limits.length < 2) return;
  const list = element("ul", {className: "legend"});
  const swatches = [];
  const add = (text, name, dashed) => {
    const swatch = element("span", {className: dashed ? "swatch dashed" : "swatch"});
    swatches.push([swatch, name]);
    list.append(element("li", {}, swatch, text));
  };
  curves.forEach((curve, i) => add(curve.name[LANG], curve.style === "alarm" ? "--fail" : `--curve-${(i % CURVES) + 1}`, i >= CURVES));
  for (const style of new Set(limits.map(curve => curve.style))) add(say(style), `--${LEVELS[style]}`, style !== "centre");
  const paint = () => swatches.forEach(([swatch, name]) => { swatch.style.borderColor = colour(name); });
  paint();
  onTheme(paint);
  frame.append(list);
}
