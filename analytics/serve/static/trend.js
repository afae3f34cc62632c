// Control charts: values in the order of time, centre and limits, what is out of control in red.
import {Plot} from "./plot.js";
import {asked, element, figure, say} from "./texts.js";

const MOST_CHARTS = 12;

export async function start(section) {
  const found = await asked(section.dataset.url);
  for (const chart of found.charts.slice(0, MOST_CHARTS)) {
    if (chart.points.length < 2) continue;
    const host = element("div", {}, element("h3", {textContent: chart.name || found.metric}));
    section.append(host);
    draw(host, chart, found);
  }
}

function draw(host, chart, found) {
  const {points, limits} = chart, dated = found.dated;
  const x = points.map((point, i) => dated && point.time ? Date.parse(point.time.replace(" ", "T") + (point.time.endsWith("Z") ? "" : "Z")) / 1000 : i + 1);
  const known = x.every((value, i) => Number.isFinite(value) && (i === 0 || value > x[i - 1]));
  const across = known ? x : points.map((_, i) => i + 1);
  const values = points.map(point => point.value), out = points.map(point => (point.rules.length ? point.value : null));
  const level = value => points.map(() => value ?? null);
  const data = [across, values, out, level(limits.centre), level(limits.lower), level(limits.upper)];
  new Plot(host, {
    data,
    options: colours => ({
      scales: {x: {time: known && dated}},
      legend: {show: false},
      series: [
        {}, {stroke: colours.link, width: 1, points: {show: true, size: 5}},
        {stroke: colours.fail, width: 0, points: {show: true, size: 8, fill: colours.fail}},
        {stroke: colours.ink, width: 1, points: {show: false}},
        {stroke: colours.marginal, width: 1, dash: [6, 4], points: {show: false}},
        {stroke: colours.marginal, width: 1, dash: [6, 4], points: {show: false}},
      ],
      axes: [{}, {label: found.unit_of_measure, size: 70}],
    }),
    label: () => say("trend", {name: chart.name || found.metric}),
    read: i => say("value", {time: points[i].time ?? `#${i + 1}`, unit: points[i].unit, value: `${figure(values[i])} ${found.unit_of_measure}`}),
  });
}
