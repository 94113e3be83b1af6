// Connects the server, the drawing and the panels.

import { known, on, publish } from "./bus.js";
import { byId, el, setText } from "./dom.js";
import { AimView } from "./aim.js";
import { charts } from "./charts.js";
import { CycleView } from "./cycle.js";
import { Drag } from "./drag.js";
import { LAYERS, PlateView } from "./plate.js";
import { Connection } from "./socket.js";
import { EmergencyStop } from "./stop.js";
import { camera } from "./panels/camera.js";
import { friction } from "./panels/friction.js";
import { log } from "./panels/log.js";
import { motors } from "./panels/motors.js";
import { nodes } from "./panels/nodes.js";
import { parameters } from "./panels/parameters.js";
import { parts } from "./panels/parts.js";
import { replay } from "./panels/replay.js";
import { simulator } from "./panels/simulator.js";
import { badge, silent, status } from "./panels/status.js";
import { tasks } from "./panels/tasks.js";

const ANSWER_SHOWN_MS = 4000; // time for which a success is shown; a refusal is shown until the next command

const view = new PlateView(watch);
const connection = new Connection(socketAddress(), { onMessage, image: (stamp, blob) => view.image(stamp, blob), changed });
const stop = new EmergencyStop(connection, (text) => alarm("stop", text));
let noteRefusal = () => {};

function socketAddress() {
  const scheme = location.protocol === "https:" ? "wss:" : "ws:";
  const token = new URLSearchParams(location.search).get("token");
  return `${scheme}//${location.host}/socket${token ? `?token=${encodeURIComponent(token)}` : ""}`;
}

function onMessage(message) {
  publish(message);
  if (message.kind === "hello") {
    byId("tab-Simulator").hidden = !message.simulator;
    allow();
    watch();
  }
}

/** Send a command and show its reply at its control; `quiet`: show only a refusal. */
async function execute(command, output, quiet = false) {
  if (output && !quiet) setText(output, "\u2026");
  const answer = await connection.send(command);
  if (!answer.ok) noteRefusal(JSON.stringify(command), answer.text);
  if (!output || (quiet && answer.ok && !output.hasAttribute("data-bad"))) return answer;
  clearTimeout(output.fading);
  output.toggleAttribute("data-bad", !answer.ok);
  output.title = answer.ok ? "" : answer.text || "";
  setText(output, answer.ok ? (quiet ? "" : `\u2713 ${answer.text || "done"}`) : `\u2715 refused: ${answer.text || "no reason given"}`);
  if (answer.ok) output.fading = setTimeout(() => setText(output, ""), ANSWER_SHOWN_MS);
  return answer;
}

/** Whether controls are enabled: if connected as an operator, not in a recorded run. */
function allow() {
  const { role, replay: recorded } = known.hello ?? {};
  const connected = connection.state === "connected" || connection.state === "silent";
  const readOnly = role === "viewer" || recorded;
  for (const controls of document.querySelectorAll(".controls")) controls.disabled = !connected || readOnly;
  byId("replay").disabled = !connected;
  byId("emergency-stop").disabled = readOnly;
  if (readOnly) stop.say(recorded ? "a recorded run: nothing to stop" : "read only: use an operator\u2019s page or the emergency stop switch");
  if (!connected) drag.drop();
}

function changed(state) {
  const words = { connected: "connected", silent: "no messages", lost: "connection lost" };
  badge(byId("connection"), state === "lost" ? "lost_connection" : state, words[state]);
  document.documentElement.dataset.connection = state;
  alarm("link", state === "lost" ? "Connection lost: the page shows old data, and the plate continues its task. Reconnecting." : state === "silent" ? "No message for 2.5 s: the page may show old data." : null);
  if (state === "connected") stop.again();
  if (state === "lost") view.ghosts.clear();
  allow();
}

const alarms = {};

function alarm(kind, text) {
  alarms[kind] = text;
  const words = [alarms.stop, alarms.link, alarms.nodes].filter(Boolean).join(" ");
  byId("alarm").hidden = !words;
  setText(byId("alarm"), words);
}

on("nodes", () => {
  const names = silent();
  alarm("nodes", names.length ? `No message from ${names.join(", ")}.` : null);
});

/** Report to the server which data this page shows. */
function watch() {
  if (!known.hello) return;
  const aims = byId("stage").dataset.view === "camera";
  const seen = !document.hidden && !aims;
  const image = seen && view.shown.image;
  if (!image) view.forgetImage();
  connection.notify({ do: "watch", image, field: seen && (view.shown.drift || view.shown.force), camera: aims && !document.hidden });
}

function layers() {
  byId("layers").append(...LAYERS.map(([key, words, shown, title]) => {
    const box = el("input", { type: "checkbox", checked: shown });
    box.addEventListener("change", () => view.show(key, box.checked));
    return el("label", { title }, box, el("span", {}, el("i", { className: `key key-${key}` }), words));
  }));
}

/** Tabs by the ARIA pattern: arrow keys move between them. */
function tabs(rooms) {
  const list = byId("tabs");
  const all = rooms.map(([name, fill]) => {
    const panel = el("section", { id: `panel-${name}`, role: "tabpanel", hidden: true, "aria-labelledby": `tab-${name}` });
    const tab = el("button", { id: `tab-${name}`, type: "button", role: "tab", "aria-controls": panel.id }, name);
    byId("panels").append(panel);
    list.append(tab);
    return { name, tab, panel, refresh: fill(panel) };
  });
  const open = (chosen, focus) => {
    for (const { tab, panel } of all) {
      const here = tab === chosen.tab;
      tab.setAttribute("aria-selected", String(here));
      tab.tabIndex = here ? 0 : -1;
      panel.hidden = !here;
    }
    byId("stage").dataset.view = chosen.name === "Camera" ? "camera" : "plate";
    watch();
    if (focus) chosen.tab.focus();
    chosen.refresh?.();
  };
  all.forEach((each, i) => {
    each.tab.addEventListener("click", () => open(each));
    each.tab.addEventListener("keydown", ({ key }) => {
      const to = { ArrowRight: i + 1, ArrowLeft: i - 1, Home: 0, End: -1 }[key];
      if (to !== undefined) open(all.at(to % all.length), true);
    });
  });
  open(all[0]);
}

/** Light or dark theme: the system's, or the one chosen here. */
function theme(redraw) {
  const choose = byId("theme");
  const dark = matchMedia("(prefers-color-scheme: dark)");
  choose.value = localStorage.getItem("theme") ?? "";
  const apply = () => {
    document.documentElement.dataset.theme = choose.value || (dark.matches ? "dark" : "light");
    localStorage.setItem("theme", choose.value);
    redraw();
  };
  choose.addEventListener("change", apply);
  dark.addEventListener("change", apply);
  apply();
}

/** After a click or touch no control keeps the focus, so that the space bar is the emergency stop. */
function leaveFocus() {
  let pressed = false;
  window.addEventListener("pointerdown", () => (pressed = true), true);
  window.addEventListener("keydown", () => (pressed = false), true);
  const leave = ({ target }) => {
    if (pressed && target.matches?.("button, summary, select, input[type=checkbox], input[type=radio], input[type=range]")) target.blur();
  };
  window.addEventListener("change", leave);
  window.addEventListener("click", ({ target }) => {
    const control = target.closest?.("button, summary, input[type=checkbox], input[type=radio]");
    if (control) leave({ target: control });
  });
}

const drag = new Drag(view, connection, execute);
status(execute);
motors();
replay(execute, view);
new CycleView();
const aim = new AimView();
layers();
tabs([
  ["Task", (panel) => tasks(panel, execute)],
  ["Parts", (panel) => {
    const refresh = parts(panel, view, drag);
    friction(panel, execute);
    return refresh;
  }],
  ["Settings", (panel) => parameters(panel, execute)],
  ["Simulator", (panel) => simulator(panel, execute, view)],
  ["Camera", (panel) => camera(panel, execute, aim)],
  ["Nodes", (panel) => nodes(panel)],
  ["Log", (panel) => (noteRefusal = log(panel)) && undefined],
]);
const redraw = charts();
theme(() => {
  redraw();
  aim.draw();
});
leaveFocus();
allow();
document.addEventListener("visibilitychange", () => {
  watch();
  view.show("image", view.shown.image);
});
