// The log: messages of the nodes, and the equivalent terminal call of each command.

import { on } from "../bus.js";
import { el } from "../dom.js";

const MOST = 300;
const SOON_MS = 300; // maximum delay between a reply and its call
const SAME_MS = 3000; // time within which the same refusal is not shown again
const SIGNS = { info: "\u00b7", warn: "!", error: "\u2715", call: "$", refused: "\u2715" };

export function log(panel) {
  const kinds = el("select", { id: "log-kinds" }, ...[["", "everything"], ["call", "commands"], ["trouble", "warnings, errors, refusals"]].map(([value, words]) => el("option", { value }, words)));
  const lines = el("ol", { className: "log", tabIndex: 0, "aria-label": "Log, newest first" });
  panel.append(
    el("h2", {}, "Log"),
    el("p", {}, el("label", { htmlFor: "log-kinds" }, "Show "), kinds),
    el("p", { className: "small" }, "A line with $ is the command that has the same effect as the control."),
    lines,
  );
  kinds.addEventListener("change", () => (lines.dataset.only = kinds.value));

  const add = (time, level, from, text, more) => {
    const when = Number.isFinite(time) ? clock(time) : "";
    const line = el("li", { className: level }, el("span", { className: "sign", "aria-hidden": "true" }, SIGNS[level] ?? "\u00b7"),
      el("time", {}, when), el("span", { className: "from" }, from), el(level === "call" || level === "refused" ? "code" : "span", { className: "text" }, text));
    if (more) line.append(el("span", { className: "more" }, more));
    lines.prepend(line);
    while (lines.childElementCount > MOST) lines.lastElementChild.remove();
  };
  on("log", (message) => message.lines.forEach(({ time, level, from, text }) => add(time, level, from, text)));
  let refusal = { text: "", at: -Infinity };
  on("call", ({ time, who, text, ok, answer }) => {
    if (ok === false) refusal = { text: answer, at: performance.now() };
    add(time, ok === false ? "refused" : "call", who, text, ok === false ? `refused: ${answer}` : answer);
  });
  /** Log a refusal, unless it is logged as the reply of a call. */
  return (command, text) =>
    setTimeout(() => {
      if (text !== refusal.text || performance.now() - refusal.at > SAME_MS) add(Date.now() / 1000, "refused", "page", command, text);
      refusal = { text, at: performance.now() };
    }, SOON_MS);
}

/** Format a stamp: wall clock as time of day, simulated time in seconds. */
function clock(time) {
  return time > 1e9 ? new Date(1000 * time).toLocaleTimeString([], { hour12: false }) : `${time.toFixed(1)} s`;
}
