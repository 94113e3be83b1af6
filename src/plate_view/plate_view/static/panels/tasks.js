// The task panel: select a scenario, change its numbers, start and end it, and show its progress.

import { known, on } from "../bus.js";
import { degrees, el, mm, seldom, setText } from "../dom.js";

/** Labels for the progress of a task: [name, label]. An error of 0 was not measured in this kind of task. */
const PROGRESS = [
  ["time", ({ time_s }) => (Number.isFinite(time_s) ? `${time_s.toFixed(1)} s` : null)],
  ["parts seen", ({ parts_seen, parts_total }) => `${parts_seen} of ${parts_total}`],
  ["in place", ({ parts_sorted, parts_total }) => `${parts_sorted} of ${parts_total}`],
  ["to go", ({ to_go_m }) => `${mm(to_go_m)} mm`],
  ["error, rms", ({ rms_error_m }) => (rms_error_m ? `${mm(rms_error_m, 2)} mm` : null)],
  ["error, max", ({ max_error_m }) => (max_error_m ? `${mm(max_error_m, 2)} mm` : null)],
  ["angle error", ({ turn_error }) => (turn_error ? `${degrees(turn_error, 1)}\u00b0` : null)],
  ["pace", ({ pace, max_error_m }) => (max_error_m && Number.isFinite(pace) ? pace.toFixed(2) : null)],
];

export function tasks(panel, execute) {
  const answer = el("output", { className: "answer" });
  const choose = el("select", { id: "scenario" });
  const about = el("p", { className: "small" });
  const numbers = el("div", { className: "numbers" });
  const edit = el("details", { hidden: true }, el("summary", {}, "Numbers of the scenario"), numbers);
  const button = (words, work, className = "") => {
    const node = el("button", { type: "button", className }, words);
    node.addEventListener("click", work);
    return node;
  };
  let scenario = null; // content of the scenario, if the server sent it
  let changed = false;
  let paused = null; // command that restarts the task
  let last = null;
  const send = async (command) => {
    const result = await execute(command, answer);
    if (result.ok) rest(null, command);
  };
  const rest = (command, begun = last) => {
    [paused, last] = [command, begun];
    setText(pause, paused ? "Resume" : "Pause");
  };
  const start = () => send(changed ? { do: "start", task: structuredClone(scenario) } : { do: "start", scenario: choose.value });
  const pause = button("Pause", async () => {
    if (paused) return send(paused);
    if (!last || known.task?.state !== "running") return setText(answer, "\u2715 refused: this page has started no running task");
    if ((await execute({ do: "cancel" }, answer)).ok) rest(last);
  });
  panel.append(el("h2", {}, "Task"),
    el("fieldset", { className: "controls stack" }, el("legend", {}, "Start a task"),
      el("label", { htmlFor: "scenario" }, "Scenario ", choose), about, edit,
      el("div", { className: "row" }, button("Start", start, "main"), pause, button("Cancel", () => execute({ do: "cancel" }, answer).then(() => rest(null))), button("Stop", () => execute({ do: "stop" }, answer))),
      el("p", { className: "small" }, "Pause and Cancel cancel the task's goal. Resume starts the task again from the parts' current places. Stop ends any task."), answer));

  const describe = () => {
    const content = known.hello?.scenarios[choose.value];
    setText(about, typeof content === "string" ? content : (content?.description ?? ""));
    scenario = typeof content === "object" ? structuredClone(content) : null;
    changed = false;
    edit.hidden = !scenario;
    if (scenario) numbers.replaceChildren(...fields(scenario, [], () => (changed = true)));
  };
  choose.addEventListener("change", describe);
  on("hello", ({ scenarios }) => {
    const before = choose.value || known.hello.scenario;
    choose.replaceChildren(...Object.keys(scenarios).map((name) => el("option", {}, name)));
    if (before in scenarios) choose.value = before;
    if (!scenario || choose.value !== before) describe();
  });

  const state = el("p", { className: "said" }, "No task yet.");
  const cells = new Map(PROGRESS.map(([name]) => [name, el("dd")]));
  const bar = el("progress", { max: 1, value: 0, "aria-label": "Parts in place" });
  panel.append(el("section", { className: "stack" }, el("h3", {}, "Progress"), state, bar,
    el("dl", { className: "figures" }, ...[...cells].map(([name, cell]) => el("div", {}, el("dt", {}, name), cell)))));
  const show = () => {
    const task = known.task;
    if (!task || panel.hidden) return;
    const { parts_seen: seen, parts_total: total, time_s: time } = task.progress ?? {};
    const waits = task.state === "running" && !time && seen < total;
    setText(state, waits ? `waiting until all parts are detected: ${seen} of ${total}` : task.text || `${task.task || "No task"}: ${task.state}`);
    const progress = task.progress ?? {};
    for (const [name, words] of PROGRESS) setText(cells.get(name), Object.keys(progress).length ? (words(progress) ?? "\u2013") : "\u2013");
    bar.value = progress.parts_total ? progress.parts_sorted / progress.parts_total : 0;
  };
  on("task", seldom(150, show));
  return show;
}

/** An input for each number in the scenario that is not a list of points. */
function fields(node, path, changed) {
  return Object.entries(node).flatMap(([key, value]) => {
    const here = [...path, value?.class ?? key]; // identify parts by class, not by number
    if (Array.isArray(value) && value.every((each) => typeof each !== "object" || Array.isArray(each))) return [];
    if (value && typeof value === "object") return fields(value, here, changed);
    if (typeof value !== "number") return [];
    const input = el("input", { type: "number", step: "any", value });
    input.addEventListener("change", () => {
      if (!Number.isFinite(input.valueAsNumber)) return;
      node[key] = input.valueAsNumber;
      changed();
    });
    return [el("label", {}, here.join(" ").replaceAll("_", " "), " ", input)];
  });
}
