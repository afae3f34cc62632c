// Allan deviation with its bounds.
import {Plot} from "./plot.js";
import {faint} from "./colours.js";
import {asked, element, figure, say} from "./texts.js";

export async function start(section) {
  const status = section.querySelector("[role=status]"), rows = section.querySelector("tbody");
  let found;
  try {
    found = await asked(section.dataset.url);
  } catch (error) {
    status.textContent = say("failed", {why: error.message});
    return;
  }
  if (rows && !rows.rows.length) { // it was not known when the page was made
    status.textContent = found.reason ?? say("computed");
    fill(rows, found);
  }
  if (!found.tau_s?.length) return;
  const host = element("div"), data = [found.tau_s, found.lo, found.hi, found.adev], unit = found.unit_of_measure;
  section.querySelector("h2").after(host);
  new Plot(host, {
    data,
    options: colours => ({
      scales: {x: {time: false, distr: 3}, y: {distr: 3}},
      legend: {show: false},
      series: [
        {}, {stroke: faint(colours.link, 0.6), width: 1, points: {show: false}}, {stroke: faint(colours.link, 0.6), width: 1, points: {show: false}},
        {stroke: colours.link, width: 2, points: {show: true, size: 5}},
      ],
      bands: [{series: [2, 1], fill: faint(colours.link, 0.2)}],
      axes: [{label: say("tau")}, {label: unit, size: 70}],
    }),
    label: () => say("allan"),
    read: i => say("point", {tau: figure(data[0][i]), value: figure(data[3][i]), lo: figure(data[1][i]), hi: figure(data[2][i]), unit}),
  });
}

function fill(rows, {tau_s, adev, lo, hi}) {
  const cell = text => element("td", {className: "number", textContent: text});
  rows.append(...tau_s.map((tau, i) => element("tr", {}, cell(figure(tau)), cell(figure(adev[i])), cell(`${figure(lo[i])} .. ${figure(hi[i])}`))));
}
