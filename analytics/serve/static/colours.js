// The page's colours, as a canvas needs them.
const probe = document.createElement("span");
probe.hidden = true;
document.body.append(probe);

/** The colour of a custom property, such as "--pass", in the theme that is shown. */
export function colour(name) {
  probe.style.color = `var(${name})`;
  return getComputedStyle(probe).color;
}

/** A colour with less opacity. */
export function faint(rgb, alpha) {
  const [red, green, blue] = rgb.match(/[\d.]+/g);
  return `rgba(${red}, ${green}, ${blue}, ${alpha})`;
}

/** Call when the theme changes, also to that of paper. */
export function onTheme(redraw) {
  for (const query of ["(prefers-color-scheme: dark)", "print"]) matchMedia(query).addEventListener("change", redraw);
}
