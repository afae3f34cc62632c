// Commands to the station of a run: the answer is shown beside the buttons, without leaving the page.
import {asked, say, trouble} from "./texts.js";

export function start(section) {
  const form = section.querySelector("form"), line = document.getElementById("command-answer");
  form?.addEventListener("submit", async event => {
    event.preventDefault();
    const button = event.submitter, action = button.value, reason = form.elements.reason;
    const headers = {"Content-Type": "application/json", "X-CSRF-Token": document.querySelector("meta[name=csrf-token]").content};
    const buttons = form.querySelectorAll("button");
    line.textContent = say("waiting");
    for (const each of buttons) each.disabled = true;
    try {
      const answer = await asked(section.dataset.url, {method: "POST", headers, body: JSON.stringify({action, reason: reason.value})});
      const zh = document.documentElement.lang.startsWith("zh") && answer.text_zh;
      line.textContent = say("answered", {action: button.textContent, text: zh ? answer.text_zh : answer.text});
      reason.value = "";
    } catch (error) {
      line.textContent = trouble(error);
    } finally {
      for (const each of buttons) each.disabled = false;
      document.getElementById("run-course").dispatchEvent(new Event("refresh"));
    }
  });
}
