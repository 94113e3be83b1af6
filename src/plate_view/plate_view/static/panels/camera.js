// The camera panel. The panel shows the steps that make a newly mounted camera ready.

import { on } from "../bus.js";
import { byId, el, setText } from "../dom.js";

const SIGNS = { ok: ["\u2713", "good"], wait: ["\u25cb", ""], warn: ["!", "warn"], error: ["\u2715", "bad"] };
const RISES = 0.04; // minimum change that is shown as a trend; smaller changes are noise

export function camera(panel, execute, aim) {
  const output = () => el("output", { className: "answer" });
  const answers = { home: output(), lens: output(), plate: output(), part: output() };
  const button = (words, command, answer, className = "") => {
    const node = el("button", { type: "button", className }, words);
    node.addEventListener("click", () => execute(command(), answer));
    return node;
  };
  const state = el("p", { className: "said", id: "camera-state" }, "No message from the detector yet.");
  const checks = el("ol", { className: "checks", id: "camera-checks" });
  const left = el("ul", { className: "small", id: "camera-left" });
  const home = el("p", { className: "small", id: "camera-home" });
  const keep = button("Write to the rig file", () => ({ do: "save_home" }), answers.home, "main");
  keep.hidden = true;
  const number = (id, words, value, step = 1) => {
    const input = el("input", { id, type: "number", value, step, min: 0 });
    return [input, el("label", { htmlFor: id }, `${words} `, input)];
  };
  const [columns, columnsBox] = number("board-columns", "Squares", 9);
  const [rows, rowsBox] = number("board-rows", "by", 7);
  const [square, squareBox] = number("board-square", "side mm", 30, "any");
  const [marker, markerBox] = number("board-marker", "marker mm", 22, "any");
  const board = () => ({
    do: "take_lens_pictures", on: true, columns: columns.valueAsNumber || 0, rows: rows.valueAsNumber || 0,
    square_m: (square.valueAsNumber || 0) / 1000, marker_m: (marker.valueAsNumber || 0) / 1000,
  });
  const discard = { do: "take_lens_pictures", on: false, columns: null, rows: null, square_m: null, marker_m: null };
  const cover = el("div", { className: "cover", role: "img" });
  const lensText = el("p", { id: "lens-text" });
  const missing = el("ul", { className: "small", id: "lens-missing" });
  const take = button("Take pictures for the lens", board, answers.lens);
  const fit = button("Fit the lens", () => ({ do: "fit_lens" }), answers.lens);
  const save = button("Write the lens to the rig file", () => ({ do: "save_lens" }), answers.lens, "main");
  const drop = button("Discard", () => discard, answers.lens);
  const taking = el("div", { className: "row" }, cover, el("div", {}, lensText, missing));
  const name = el("input", { id: "teach-name", type: "text", maxLength: 40, autocomplete: "off", spellcheck: false, required: true });
  const teach = el("form", { className: "row" }, el("label", { htmlFor: "teach-name" }, "Type ", name), el("button", { type: "submit" }, "Teach this part"));
  teach.addEventListener("submit", (event) => {
    event.preventDefault();
    execute({ do: "teach", name: name.value.trim() }, answers.part);
  });
  const step = (words, text, ...content) =>
    el("fieldset", { className: "controls stack" }, el("legend", {}, words), el("p", { className: "small" }, text), ...content);
  panel.append(el("h2", {}, "Camera"), state, checks,
    step("1. The lens", "Hold a printed board in front of the camera, in each corner and tilted to each side, each time still for a second. A marker side of 0 means a chessboard.",
      el("div", { className: "row" }, columnsBox, rowsBox, squareBox, markerBox), taking,
      el("div", { className: "row" }, take, fit, save, drop), answers.lens),
    step("2. Home", "Calibrate the lens first. The plate must be at rest and completely in the picture. The search uses the markers on the plate or, without markers, its outline.",
      el("div", { className: "row" }, button("Find home", () => ({ do: "find_home" }), answers.home), keep), answers.home, home),
    step("3. The plate", "Only for rigs with part types. Remove all parts from the plate, and set up the light as it will be in operation.",
      el("div", { className: "row" }, button("Learn the bare plate", () => ({ do: "learn_plate" }), answers.plate)), answers.plate),
    step("4. Parts", "Put one part of a new type on the plate, away from the edge, and give the type a name.", teach, answers.part),
    el("section", { className: "stack" }, el("h3", {}, "Objects not detected as parts"), left));

  const showLens = ({ state: now, kept, needed, columns: wide, cover: cells, missing: lacks, text, error_px: error, file }) => {
    taking.hidden = now === "idle";
    [fit.hidden, drop.hidden, save.hidden] = [now !== "taking", now === "idle", now !== "fitted"];
    take.hidden = now !== "idle";
    fit.disabled = kept < needed;
    if (now === "idle") {
      setText(lensText, "");
      missing.replaceChildren();
      return;
    }
    cover.style.gridTemplateColumns = `repeat(${wide}, 1fr)`;
    cover.replaceChildren(...cells.map((seen) => el("i", { className: seen ? "seen" : "" })));
    cover.setAttribute("aria-label", `The board was seen in ${cells.filter(Boolean).length} of ${cells.length} parts of the picture`);
    const words = now === "fitted" ? `Error ${error.toFixed(3)} px; ${text}. Write it to ${file}?` : `${kept} taken; ${text}.`;
    setText(lensText, words);
    const next = now === "taking" ? lacks : [];
    missing.replaceChildren(...next.map((each) => el("li", {}, each)));
    if (now === "taking" && !lacks.length) missing.append(el("li", {}, "enough pictures: fit the lens"));
  };
  let said = "";
  const show = () => {
    const now = aim.known;
    if (!now || panel.hidden) return;
    checks.replaceChildren(...now.checks.map(({ name: what, level, text }) => {
      const [sign, grade] = SIGNS[level];
      return el("li", { "data-grade": grade, "data-check": what }, el("b", {}, sign), el("b", {}, what), el("span", {}, text));
    }));
    const next = now.checks.find(({ level }) => level !== "ok");
    const words = next ? `Next: ${next.name}.` : "\u2713 Ready: the camera is set up.";
    setText(state, words);
    state.dataset.grade = next ? "" : "good";
    if (words !== said) setText(byId("spoken"), next ? `${words} ${next.text}` : words);
    said = words;
    setText(home, now.home && `Home: ${now.home}${now.home_found ? ". Write them to the rig file?" : ""}`);
    keep.hidden = !now.home_found;
    const { change, sharpness } = now;
    const trend = change === null || Math.abs(change) <= RISES ? "\u2192 steady" : change > 0 ? "\u2197 rises" : "\u2198 falls";
    setText(byId("sharpness-note"), sharpness === null ? "not measured" : `${sharpness.toFixed(3)} per px, ${trend}`);
    const things = Map.groupBy(now.things.filter(({ id }) => !id), ({ reason }) => reason);
    left.replaceChildren(...[...things].map(([reason, all]) => el("li", {}, `${all.length} ${reason}: ${all[0].remedy}`)));
    if (!things.size) left.append(el("li", {}, "none"));
    showLens(now.lens);
  };
  on("aim", show);
  showLens({ state: "idle", kept: 0, needed: 1 });
  return () => {
    show();
    aim.draw();
  };
}
