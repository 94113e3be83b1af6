// The table of parts: the content of the drawing as text. Targets can be moved with the keyboard.

import { on } from "../bus.js";
import { degrees, el, mm, seldom, setText } from "../dom.js";

const STEP_M = 0.001;
const TURN = Math.PI / 36;
const KEYS = {
  ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], q: [0, 0, 1], e: [0, 0, -1],
};

export function parts(panel, view, drag) {
  const body = el("tbody");
  const table = el("table", {}, el("caption", { className: "hidden" }, "Parts on the plate"),
    el("thead", {}, el("tr", {}, ...["part", "x mm", "y mm", "angle \u00b0", "\u00b1 mm", "to go", "seen"].map((head) => el("th", { scope: "col" }, head)))), body);
  const fields = ["x", "y", "angle"].map((name) => el("input", { type: "number", id: `target-${name}`, step: name === "angle" ? 5 : 1 }));
  const send = el("button", { type: "submit", className: "main" }, "Send");
  const form = el("form", { className: "row" }, ...["x mm", "y mm", "angle \u00b0"].map((words, i) => el("label", { htmlFor: fields[i].id }, `${words} `, fields[i])), send);
  const legend = el("legend", {}, "Target: choose a part");
  const group = el("fieldset", { className: "controls stack" }, legend, form,
    el("p", { className: "small" }, "On a row, the arrow keys move its target by 1 mm (Shift: 10 mm), and Q and E rotate it by 5\u00b0."));
  const count = el("p", { className: "small" });
  panel.append(el("h2", {}, "Parts"), group, count, el("div", { className: "scroll", tabIndex: 0, role: "region", "aria-label": "Table of parts" }, table));
  const rows = new Map();
  let chosen = null;

  const choose = (id) => {
    chosen = id;
    view.hold = id;
    view.chosen = new Set([id]);
    const aim = view.aim(id);
    setText(legend, `Target of ${id}`);
    fields[0].value = (1000 * aim.x).toFixed(1);
    fields[1].value = (1000 * aim.y).toFixed(1);
    fields[2].value = aim.angle === null || aim.angle === undefined ? "" : ((180 / Math.PI) * aim.angle).toFixed(0);
    fields[2].disabled = !view.part(id)?.turns;
    for (const [key, { row }] of rows) row.classList.toggle("chosen", key === id);
    view.draw(true);
  };
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    if (!chosen || fields.slice(0, 2).some((field) => !Number.isFinite(field.valueAsNumber))) return;
    const angle = fields[2].disabled || fields[2].value === "" ? null : (fields[2].valueAsNumber * Math.PI) / 180;
    drag.send([{ id: chosen, x: fields[0].valueAsNumber / 1000, y: fields[1].valueAsNumber / 1000, angle }]);
  });
  body.addEventListener("keydown", (event) => {
    const way = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    const id = event.target.closest("tr")?.dataset.id;
    if (!way || !id || event.ctrlKey || event.metaKey || event.altKey || !drag.allowed) return;
    event.preventDefault();
    const aim = view.aim(id);
    const step = STEP_M * (event.shiftKey ? 10 : 1);
    const angle = view.part(id)?.turns ? (aim.angle ?? 0) + TURN * way[2] : null;
    drag.send([{ id, x: aim.x + step * way[0], y: aim.y + step * way[1], angle }]);
    choose(id);
  });

  const show = () => {
    if (panel.hidden) return;
    const all = view.parts;
    for (const part of all) {
      if (!rows.has(part.id)) rows.set(part.id, line(part.id, choose));
      const { row, cells } = rows.get(part.id);
      if (!row.isConnected) body.append(row);
      const target = view.ghosts.get(part.id) ?? view.target(part.id);
      const words = [mm(part.x), mm(part.y), part.turns ? degrees(part.angle) : "\u2013", part.sd ? mm(2 * Math.hypot(part.sd[0], part.sd[1]), 2) : "\u2013",
        target ? mm(Math.hypot(target.x - part.x, target.y - part.y)) : "\u2013", part.seen ? "yes" : "no"];
      words.forEach((word, i) => setText(cells[i], word));
    }
    if (rows.size > all.length) {
      const there = new Set(all.map(({ id }) => id));
      for (const [id, { row }] of rows) if (!there.has(id) && rows.delete(id)) row.remove();
    }
    setText(count, `${all.length} parts, ${all.filter(({ seen }) => seen).length} seen in the last image; \u00b1: two standard deviations.`);
  };
  const later = seldom(250, show);
  on("parts", later);
  on("targets", later);
  const describe = seldom(2000, () => {
    const all = view.parts;
    view.canvas.setAttribute("aria-label", `The plate from above: ${all.length} parts, ${all.filter(({ seen }) => seen).length} of them seen. The table under \u201cParts\u201d lists their places.`);
  });
  on("parts", describe);
  return show;
}

function line(id, choose) {
  const cells = Array.from({ length: 6 }, () => el("td"));
  const button = el("button", { type: "button", className: "plain" }, id);
  const row = el("tr", {}, el("th", { scope: "row" }, button), ...cells);
  row.dataset.id = id;
  row.addEventListener("click", () => choose(id));
  return { row, cells };
}
