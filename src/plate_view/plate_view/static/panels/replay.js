// Replay of a recorded run: play, seek and rate.

import { known, on } from "../bus.js";
import { byId, setText } from "../dom.js";

export function replay(execute, view) {
  const [bar, seek, play, rate, answer] = ["replay", "replay-seek", "replay-play", "replay-rate", "replay-answer"].map(byId);
  on("hello", (hello) => (bar.hidden = !hello.replay));
  on("replay", ({ begin, end, now, playing, rate: at, problem }) => {
    bar.hidden = false;
    Object.assign(seek, { min: begin, max: end });
    if (document.activeElement !== seek || playing) seek.value = now;
    setText(play, playing ? "Pause" : "Play");
    if (document.activeElement !== rate) rate.value = String(at);
    setText(byId("replay-time"), `${(now - begin).toFixed(1)} of ${(end - begin).toFixed(1)} s${problem && `: ${problem}`}`);
  });
  play.addEventListener("click", () => execute({ do: "replay", playing: !known.replay?.playing }, answer));
  seek.addEventListener("input", () => {
    view.trails.clear();
    execute({ do: "replay", seek: seek.valueAsNumber }, answer, true);
  });
  rate.addEventListener("change", () => execute({ do: "replay", rate: Number(rate.value) }, answer));
}
