// Allan deviation of chosen units with bounds and limits, kept up to date while the run goes on.
import uPlot from "./uplot/uPlot.esm.js";
import {Plot} from "./plot.js";
import {faint} from "./colours.js";
import {asked, element, figure, say, trouble} from "./texts.js";

const FOLLOW_MS = 3000, LOOK_AGAIN_MS = 15000;

export async function start(section) {
  limit(section);
  const view = {section, plot: null, host: element("div", {id: "run-allan-plot"})};
  section.querySelector("form").after(view.host);
  await refresh(view);
}

/** No more boxes can be checked than curves may be shown. */
function limit(section) {
  const boxes = [...section.querySelectorAll("input[name=show]")], most = Number(section.dataset.most);
  const look = () => {
    const full = boxes.filter(box => box.checked).length >= most;
    for (const box of boxes) box.disabled = full && !box.checked;
  };
  section.addEventListener("change", look);
  look();
}

async function refresh(view) {
  let found;
  try {
    found = await asked(view.section.dataset.url);
    document.getElementById("allan-trouble").textContent = "";
  } catch (error) {
    document.getElementById("allan-trouble").textContent = trouble(error);
    setTimeout(() => refresh(view), FOLLOW_MS);
    return;
  }
  // a run that nobody is at work on may go on, until it has ended
  const wait_ms = found.is_live ? FOLLOW_MS : LOOK_AGAIN_MS;
  const follow = () => setTimeout(() => (document.hidden ? follow() : refresh(view)), wait_ms);
  if (found.outcome === "open") follow();
  draw(view, found);
}

function draw(view, found) {
  const shown = found.units.filter(each => each.curve?.tau_s.length);
  if (!shown.length) return;
  const unit = shown[0].curve.unit_of_measure;
  const data = uPlot.join(shown.map(({curve}) => [curve.tau_s, curve.lo, curve.hi, curve.adev]));
  const limits = shown.flatMap(each => each.limits);
  const parts = {
    data,
    options: colours => {
      const inks = [colours.link, colours.pass, colours.marginal, colours.soft];
      const dashes = [[], [8, 4], [2, 3]];
      return {
        scales: {x: {time: false, distr: 3}, y: {distr: 3, range: (_plot, low, high) => around(low, high, limits)}},
        legend: {show: true, live: false},
        series: [{}, ...shown.flatMap((each, k) => {
          const ink = inks[k % inks.length], thin = {stroke: faint(ink, 0.5), width: 1, points: {show: false}, label: `${each.unit}, ${say("bound")}`};
          return [thin, thin, {label: each.unit, stroke: ink, width: 2, dash: dashes[Math.floor(k / inks.length)], points: {show: true, size: 4}}];
        })],
        bands: shown.map((_, k) => ({series: [3 * k + 2, 3 * k + 1], fill: faint(inks[k % inks.length], 0.15)})),
        axes: [{label: say("tau")}, {label: unit, size: 70}],
        hooks: {ready: [named], draw: [plot => mark(plot, limits, colours.fail)]},
      };
    },
    label: () => say("allans", {n: shown.length}),
    read: i => shown.map((each, k) => [each.unit, data[3 * k + 3][i], data[3 * k + 1][i], data[3 * k + 2][i]])
      .filter(row => row[1] !== null && row[1] !== undefined)
      .map(([name, value, lo, hi]) => `${name} ${say("point", {tau: figure(data[0][i]), value: figure(value), lo: figure(lo), hi: figure(hi), unit})}`).join("; "),
  };
  if (view.plot) {
    Object.assign(view.plot.parts, parts);
    view.plot.show(data);
  } else {
    view.plot = new Plot(view.host, parts);
  }
  view.section.dataset.limits = String(limits.length);
  view.section.dataset.samples = String(Math.max(...shown.map(each => each.curve.samples)));
  const items = found.units.flatMap(each => each.limits.map(one => element("li", {},
    say("of_limit", {unit: each.unit, name: say(one.characteristic), tau: figure(one.tau_s), limit: say("limit"), upper: figure(one.upper), measure: unit}),
    `${one.value === null ? "–" : figure(one.value) + say("bounds", {lo: figure(one.lo), hi: figure(one.hi)})} `,
    say(`limit_${one.comparison}`))));
  if (items.length) document.getElementById("allan-limits").replaceChildren(...items);
}

/** Leave the bounds out of the legend. */
function named(plot) {
  [...plot.root.querySelectorAll(".u-legend .u-series")].forEach((row, i) => i % 3 === 2 || row.remove());
}

/** A scale in which the limits are seen too. */
function around(low, high, limits) {
  const values = [low, high, ...limits.map(each => each.upper)].filter(value => value > 0 && Number.isFinite(value));
  return values.length ? uPlot.rangeLog(Math.min(...values) / 1.2, Math.max(...values) * 1.2, 10, false) : [0.1, 1];
}

/** A limit as a bar at its averaging time. */
function mark(plot, limits, ink) {
  const {ctx, bbox} = plot;
  ctx.save();
  ctx.strokeStyle = ink;
  ctx.lineWidth = 3 * devicePixelRatio;
  for (const {tau_s: tau, upper} of limits) {
    const y = plot.valToPos(upper, "y", true), left = plot.valToPos(tau / 1.4, "x", true), right = plot.valToPos(tau * 1.4, "x", true);
    ctx.beginPath();
    ctx.moveTo(Math.max(left, bbox.left), y);
    ctx.lineTo(Math.min(right, bbox.left + bbox.width), y);
    ctx.stroke();
  }
  ctx.restore();
}
