// The motors: their travel in the running cycle, and the fractions of the limits that the cycle
// uses.

import { known, on } from "../bus.js";
import { byId, clamp, el, mm, seldom, setText } from "../dom.js";

function bar(name) {
  const fill = el("div", { className: "fill" });
  const value = el("span", { className: "value" });
  const row = el("div", { className: "meter" }, el("span", { className: "label" }, name), el("div", { className: "track" }, fill), value);
  return { row, fill, value };
}

export function motors() {
  const box = byId("motors");
  let rows = {};
  let newest = null;
  const build = (names, kinds) => {
    rows = Object.fromEntries([...names, ...kinds].map((name) => [name, bar(name.replace("_", " "))]));
    for (const name of names) rows[name].row.classList.add("position");
    box.replaceChildren(...Object.values(rows).map(({ row }) => row));
  };
  const show = () => {
    const { names, lo, hi, used } = newest;
    const kinds = Object.keys(used ?? {});
    if (![...names, ...kinds].every((name) => rows[name])) build(names, kinds);
    const stroke = known.hello?.rig.stroke ?? Math.max(...hi, ...lo.map((low) => -low));
    const place = (position) => 50 * (1 + clamp(position / stroke, -1, 1));
    names.forEach((name, i) => {
      rows[name].fill.style.left = `${place(lo[i])}%`;
      rows[name].fill.style.width = `${place(hi[i]) - place(lo[i])}%`;
      setText(rows[name].value, `${mm(lo[i])} to ${mm(hi[i])}`);
    });
    for (const kind of kinds) {
      const { row, fill, value } = rows[kind];
      const over = used[kind] > 1.0005;
      fill.style.width = `${100 * clamp(used[kind], 0, 1)}%`;
      row.classList.toggle("over", over);
      setText(value, `${Math.round(100 * used[kind])} %${over ? " !" : ""}`);
    }
  };
  const later = seldom(100, show);
  on("motors", (message) => {
    newest = message;
    if (!document.hidden) later();
  });
}
