// Statements without leaving the page: result as a table and a plot, history, a link that brings the query back.
import {Plot} from "./plot.js";
import {asked, element, figure, say} from "./texts.js";

const KEPT = 30, SHOWN_ROWS = 1000, KEY = "gyrofleet-sql";
const NUMBER = /INT|DOUBLE|FLOAT|DECIMAL|HUGEINT|REAL/i, TIME = /TIMESTAMP|DATE/i;

export function start(form) {
  const text = form.querySelector("textarea"), result = document.getElementById("sql-result");
  const history = element("select", {"aria-label": say("history")});
  form.querySelector("p").append(" ", history);
  const remembered = () => JSON.parse(localStorage.getItem(KEY) ?? "[]");
  const list = () => history.replaceChildren(element("option", {value: "", textContent: say("history")}), ...remembered().map(sql => element("option", {value: sql, textContent: sql.slice(0, 80)})));
  list();
  history.addEventListener("change", () => { if (history.value) text.value = history.value; });
  text.addEventListener("keydown", event => { if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) form.requestSubmit(); });
  form.addEventListener("submit", async event => {
    event.preventDefault();
    const sql = text.value.trim();
    if (!sql) return;
    localStorage.setItem(KEY, JSON.stringify([sql, ...remembered().filter(each => each !== sql)].slice(0, KEPT)));
    list();
    window.history.replaceState(null, "", `?${new URLSearchParams({sql})}`);
    result.replaceChildren(element("p", {role: "status", textContent: say("loading")}));
    const token = document.querySelector("meta[name=csrf-token]")?.content;
    try {
      const headers = {"Content-Type": "application/json", Accept: "application/json", ...(token ? {"X-CSRF-Token": token} : {})};
      show(result, await asked(form.dataset.api, {method: "POST", headers, body: JSON.stringify({sql, shape: "arrays"})}));
    } catch (error) {
      result.replaceChildren(element("p", {role: "alert", textContent: error.message}));
    }
  });
}

function show(result, found) {
  const {columns, rows} = found;
  const told = say("rows", {n: found.count, s: figure(found.seconds)}) + (found.truncated ? `, ${say("cut", {n: found.count})}` : "");
  const head = element("tr", {}, ...columns.map(column => element("th", {scope: "col", title: column.type, textContent: column.name})));
  const cell = value => element("td", {className: typeof value === "number" ? "number" : "", textContent: value === null ? "" : typeof value === "object" ? JSON.stringify(value) : String(value)});
  const body = rows.slice(0, SHOWN_ROWS).map(row => element("tr", {}, ...row.map(cell)));
  const table = element("table", {}, element("thead", {}, head), element("tbody", {}, ...body));
  const host = element("div");
  result.replaceChildren(element("p", {role: "status", textContent: told}), host, element("div", {className: "wide", tabIndex: 0, role: "group", "aria-label": told}, table));
  draw(host, columns, rows);
}

function draw(host, columns, rows) {
  const across = columns.findIndex(column => NUMBER.test(column.type) || TIME.test(column.type));
  const up = columns.map((column, i) => [column, i]).filter(([column, i]) => i !== across && NUMBER.test(column.type)).slice(0, 4);
  if (across < 0 || !up.length || rows.length < 3) return;
  const time = TIME.test(columns[across].type);
  const x = row => (time ? Date.parse(`${String(row[across]).replace(" ", "T")}Z`) / 1000 : row[across]);
  const sorted = rows.filter(row => Number.isFinite(x(row))).sort((a, b) => x(a) - x(b));
  if (sorted.length < 3) return;
  const data = [sorted.map(x), ...up.map(([, i]) => sorted.map(row => row[i]))];
  new Plot(host, {
    data,
    options: colours => ({
      scales: {x: {time}},
      series: [{label: columns[across].name}, ...up.map(([column], k) => ({label: column.name, stroke: [colours.link, colours.fail, colours.pass, colours.marginal][k], width: 1}))],
      axes: [{label: columns[across].name}, {size: 70}],
    }),
    label: () => say("plot"),
    read: i => data.map((values, k) => `${k ? up[k - 1][0].name : columns[across].name} ${figure(values[i])}`).join(", "),
  });
}
