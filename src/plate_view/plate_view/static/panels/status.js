// The header: rig, task, measured values and motors.

import { known, on } from "../bus.js";
import { byId, setText } from "../dom.js";

/** A sign for each state, so that it is not shown by colour alone. */
const GRADES = {
  running: ["\u25b6", "good"], done: ["\u2713", "good"], ready: ["\u2713", "good"], idle: ["\u25cb", ""],
  stuck: ["!", "warn"], lost: ["!", "warn"], aborted: ["\u25a0", "warn"], disabled: ["\u25cb", "warn"],
  enabling: ["\u2026", ""], calibrating: ["\u2026", ""], braking: ["\u25a0", "bad"], stopped: ["\u25a0", "bad"],
  error: ["\u2715", "bad"], connected: ["\u25cf", "good"], silent: ["!", "warn"], lost_connection: ["\u2715", "bad"],
  ok: ["\u2713", "good"], warn: ["!", "warn"], stale: ["?", "warn"],
};

/** Show a state as a badge. */
export function badge(node, state, words = state) {
  const [sign, grade] = GRADES[state.toLowerCase()] ?? ["?", ""];
  setText(node, `${sign} ${words}`);
  node.dataset.grade = grade;
}

const SILENT_S = 1.5; // maximum age of a report; nodes report each second, so a missing report is shown within 2 s

/** The names of nodes without recent reports, except pages, which start and end at any time. */
export function silent() {
  if (known.hello?.replay) return [];
  return (known.nodes?.nodes ?? []).filter(({ name, age }) => age > SILENT_S && !name.startsWith("page")).map(({ name }) => name);
}

const rate = (value) => (Number.isFinite(value) ? `${value.toFixed(1)} /s` : "\u2013");

export function status(execute) {
  on("hello", ({ rig, role, replay }) => {
    setText(byId("rig-name"), rig.name);
    document.title = `Plate: ${rig.name}`;
    byId("rig-name").title = `${Math.round(1000 * rig.length)} \u00d7 ${Math.round(1000 * rig.width)} mm, stroke \u00b1${(1000 * rig.stroke).toFixed(1)} mm`;
    setText(byId("role"), replay ? "recorded run" : role === "viewer" ? "read only" : "operator");
  });
  let lastSpoken = "";
  on("task", ({ task, state, text }) => {
    badge(byId("task-state"), state, task ? `${task}: ${state}` : state);
    const words = text === state ? "" : (text || "").replace(`${state}: `, ""); // omit the state, because the badge shows it
    setText(byId("task-text"), words);
    byId("task-text").title = words;
    if (`${task} ${state}` !== lastSpoken) setText(byId("spoken"), `Task ${task} ${state}. ${text || ""}`);
    lastSpoken = `${task} ${state}`;
  });
  const driver = () => {
    if (!known.driver) return;
    const { state, text } = known.driver;
    const lost = silent().includes("driver");
    badge(byId("driver-state"), lost ? "silent" : state, lost ? `no message (was ${state})` : state);
    byId("driver-state").title = text || "";
    setText(byId("enable"), state === "ready" ? "Disable" : "Enable");
  };
  on("driver", driver);
  on("nodes", driver);
  on("timing", ({ latency_ms: ms, image_rate, cycle_rate }) => {
    setText(byId("reading-latency"), ms && Number.isFinite(ms.median) ? `${ms.median.toFixed(1)} ms` : "\u2013");
    byId("images").hidden = !Number.isFinite(image_rate);
    setText(byId("reading-images"), rate(image_rate));
    setText(byId("reading-cycles"), rate(cycle_rate));
  });
  const answer = byId("plate-answer");
  byId("enable").addEventListener("click", () => execute({ do: "enable", on: known.driver?.state !== "ready" }, answer));
  byId("cut-power").addEventListener("click", () => execute({ do: "cut_power" }, answer));
}
