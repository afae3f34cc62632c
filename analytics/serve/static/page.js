// Loads what a page needs; without scripts every page is whole as tables.
const PARTS = {
  "live-floor": "./floor.js", "signal-plot": "./signal.js", "allan-plot": "./allan.js", "sql-form": "./sql.js",
  "run-course": "./run_course.js", "run-allan": "./run_allan.js", "run-control": "./run_control.js",
  "rest-of-page": "./later.js",
};

for (const [id, module] of Object.entries(PARTS)) {
  const section = document.getElementById(id);
  if (section) import(module).then(part => part.start(section));
}
for (const section of document.querySelectorAll("[data-figure]")) import("./figure.js").then(part => part.start(section));
