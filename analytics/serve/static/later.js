// A page whose rest is still being computed: looks every two seconds, and shows it when it is there.
const EVERY_MS = 2000;

export function start(section) {
  const look = async () => {
    try {
      const answer = await fetch(location.href, {headers: {Accept: "text/html", "X-Partial": "1"}});
      if (answer.ok && !(await answer.text()).includes(`id="${section.id}"`)) return location.reload();
    } catch { /* the server comes back */ }
    setTimeout(look, EVERY_MS);
  };
  setTimeout(look, EVERY_MS);
}
