// Statements without leaving the page: result as a table and a plot, history, a link that brings the query back.
import {draw} from "./figure.js";
import {asked, element, figure, say} from "./texts.js";

const KEPT = 30, SHOWN_ROWS = 1000, KEY = "gyrofleet-sql", MOST_CURVES = 12, FEWEST = 3, MANY = 200;
const NUMBER = /INT|DOUBLE|FLOAT|DECIMAL|HUGEINT|REAL/i, TIME = /TIMESTAMP|DATE/i, TEXT = /STRING|VARCHAR|UTF8/i;

export function start(form) {
  const text = form.querySelector("textarea"), result = document.getElementById("sql-result");
  const history = element("select", {"aria-label": say("history")});
  const link = element("a", {textContent: say("link"), hidden: true});
  form.querySelector("p").append(" ", history, " ", link);
  const remembered = () => JSON.parse(localStorage.getItem(KEY) ?? "[]");
  const list = () => history.replaceChildren(element("option", {value: "", textContent: say("history")}), ...remembered().map(sql => element("option", {value: sql, textContent: sql.slice(0, 80)})));
  list();
  history.addEventListener("change", () => { if (history.value) text.value = history.value; });
  text.addEventListener("keydown", event => { if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) form.requestSubmit(); });
  insertable(text);
  form.addEventListener("submit", async event => {
    const sql = text.value.trim();
    if (sql) {
      localStorage.setItem(KEY, JSON.stringify([sql, ...remembered().filter(each => each !== sql)].slice(0, KEPT)));
      list();
    }
    if (event.submitter?.name === "format") return; // the browser saves the file
    event.preventDefault();
    if (!sql) return;
    const address = new URL(location.href);
    if (address.searchParams.get("sql") !== sql) for (const name of ["across", "up", "by"]) address.searchParams.delete(name);
    address.searchParams.set("sql", sql);
    window.history.replaceState(null, "", address);
    link.href = address;
    link.hidden = false;
    result.replaceChildren(element("p", {role: "status", textContent: say("loading")}));
    const token = document.querySelector("meta[name=csrf-token]")?.content;
    try {
      const headers = {"Content-Type": "application/json", Accept: "application/json", ...(token ? {"X-CSRF-Token": token} : {})};
      show(result, await asked(form.dataset.api, {method: "POST", headers, body: JSON.stringify({sql, shape: "shown"})}), link);
    } catch (error) {
      result.replaceChildren(element("p", {role: "alert", textContent: error.message}));
    }
  });
}

/** Names of columns become buttons that write them into the statement. */
function insertable(text) {
  for (const code of document.querySelectorAll("[data-insert]")) {
    const button = element("button", {type: "button", className: "name", textContent: code.dataset.insert, "aria-label": say("insert", {name: code.dataset.insert})});
    button.addEventListener("click", () => text.setRangeText(code.dataset.insert, text.selectionStart, text.selectionEnd, "end"));
    code.replaceWith(button);
  }
}

function show(result, found, link) {
  const {columns, rows} = found;
  const told = say("rows", {n: found.count, s: figure(found.seconds)}) + (found.truncated ? `, ${say("cut", {n: found.count})}` : "");
  const head = element("tr", {}, ...columns.map(column => element("th", {scope: "col", title: column.type, textContent: column.name})));
  const cell = value => element("td", {className: value === null ? "soft" : typeof value === "number" ? "number" : "", textContent: value === null ? "NULL" : typeof value === "object" ? JSON.stringify(value) : String(value)});
  const body = rows.slice(0, SHOWN_ROWS).map(row => element("tr", {}, ...row.map(cell)));
  const table = element("table", {}, element("thead", {}, head), element("tbody", {}, ...body));
  const host = element("div");
  result.replaceChildren(element("p", {role: "status", textContent: told}), host, element("div", {className: "wide tall", tabIndex: 0, role: "group", "aria-label": told}, table));
  plotted(host, columns, rows, link);
}

/** The plot of a result, with what is drawn over what; the choice is kept in the address. */
function plotted(host, columns, rows, link) {
  const of = pattern => columns.map((column, i) => ({...column, i})).filter(column => pattern.test(column.type));
  const numbers = of(NUMBER), times = of(TIME), places = [...times, ...numbers].sort((a, b) => a.i - b.i);
  if (!places.length || numbers.length + times.length < 2 || rows.length < FEWEST) return;
  const address = new URL(location.href), picture = element("div");
  const choice = (name, label, options, usual) => {
    const wanted = address.searchParams.get(name), known = options.some(each => each.name === wanted);
    const select = element("select", {}, ...options.map(each => element("option", {value: each.name, textContent: each.label ?? each.name})));
    select.value = known ? wanted : usual;
    select.addEventListener("change", () => {
      const now = new URL(location.href);
      now.searchParams.set(name, select.value);
      window.history.replaceState(null, "", now);
      link.href = now;
      redraw();
    });
    host.append(element("label", {}, `${label} `, select), " ");
    return select;
  };
  const across = choice("across", say("across"), places, places[0].name);
  const up = choice("up", say("up"), numbers, (numbers.find(each => each.name === "value" || each.name === "mean") ?? numbers.find(each => each.name !== across.value) ?? numbers[0]).name);
  const by = choice("by", say("by"), [{name: "", label: say("nothing")}, ...of(TEXT)], grouped(of(TEXT), rows));
  const redraw = () => {
    picture.replaceChildren();
    const at = name => columns.findIndex(column => column.name === name);
    const [x, y, group] = [at(across.value), at(up.value), at(by.value)], time = TIME.test(columns[x].type);
    const place = row => (time ? instant(String(row[x])) : row[x]);
    const curves = new Map();
    for (const row of rows) {
      const value = place(row), name = group < 0 ? columns[y].name : String(row[group] ?? "–");
      if (!Number.isFinite(value) || typeof row[y] !== "number") continue;
      if (!curves.has(name)) curves.set(name, {name: both(name), x: [], y: [], style: rows.length > MANY ? "line" : "both"});
      if (value <= curves.get(name).x.at(-1)) curves.get(name).style = "points"; // no function of what is across
      curves.get(name).x.push(value);
      curves.get(name).y.push(row[y]);
    }
    const shown = [...curves.values()].slice(0, MOST_CURVES);
    draw(picture, {title: both(columns[y].name), x: {label: both(columns[x].name), unit: "", scale: time ? "time" : "linear"}, y: {label: both(columns[y].name), unit: ""}, curves: shown});
    if (curves.size > shown.length) picture.append(element("p", {className: "soft", textContent: say("more", {n: curves.size - shown.length})}));
  };
  host.append(picture);
  redraw();
}

/** The first column of texts that makes a few groups of several rows each. */
function grouped(texts, rows) {
  const found = texts.find(column => {
    const n = new Set(rows.map(row => row[column.i])).size;
    return n > 1 && n <= MOST_CURVES && rows.length >= 2 * n;
  });
  return found?.name ?? "";
}

/** Seconds of a date, or of a time stamp, which is in UTC whatever it says of its zone. */
function instant(text) {
  const time = /\d:\d/.test(text);
  return Date.parse(time ? `${text.replace(" ", "T").replace(/(Z|[+-]\d\d(:?\d\d)?)$/, "")}Z` : text) / 1000;
}

const both = text => ({en: text, zh: text});
