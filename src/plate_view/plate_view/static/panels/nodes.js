// The nodes: their states, the ages of their last reports, and their values.

import { on } from "../bus.js";
import { el, seldom, setText } from "../dom.js";
import { badge } from "./status.js";

export function nodes(panel) {
  const list = el("div", { className: "nodes" }, el("p", { className: "empty" }, "No node has reported yet."));
  const note = el("p", { className: "small" });
  panel.append(el("h2", {}, "Nodes"), list, note);
  const rows = new Map();
  let newest = [];
  const show = () => {
    if (panel.hidden) return;
    if (newest.length && !rows.size) list.replaceChildren();
    for (const { name, level, message, age, values } of newest) {
      if (!rows.has(name)) {
        const row = { level: el("span", { className: "badge" }), text: el("p", {}), age: el("span", { className: "small" }), values: el("dl", {}) };
        rows.set(name, row);
        list.append(el("details", {}, el("summary", {}, row.level, el("strong", {}, ` ${name} `), row.age, row.text), row.values));
      }
      const row = rows.get(name);
      badge(row.level, level);
      setText(row.age, Number.isFinite(age) ? `${age.toFixed(1)} s ago` : "");
      setText(row.text, message || "");
      const pairs = Object.entries(values ?? {});
      const text = JSON.stringify(pairs);
      if (row.known !== text) row.values.replaceChildren(...pairs.flatMap(([key, value]) => [el("dt", {}, key), el("dd", {}, String(value))]));
      row.known = text;
    }
  };
  const later = seldom(300, show);
  on("nodes", (message) => {
    newest = message.nodes;
    later();
  });
  on("timing", ({ frames_dropped, late, browsers }) => setText(note, [
    Number.isFinite(late) ? `${late} late answers` : "", Number.isFinite(frames_dropped) ? `${frames_dropped} images skipped by this page` : "",
    Number.isFinite(browsers) ? `pages open: ${browsers}` : "",
  ].filter(Boolean).join("; ")));
  return show;
}
