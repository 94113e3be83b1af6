// Helper functions for elements and numbers.

export const byId = (id) => document.getElementById(id);

/** Create an element. `props` are properties, or attributes if there is no such property. */
export function el(tag, props = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (name in node && name !== "list") node[name] = value;
    else node.setAttribute(name, value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}

/** Set the text only if it changes, so that frequent calls are cheap. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Metres as millimetres, "-12.3". */
export const mm = (metres, digits = 1) =>
  Number.isFinite(metres) ? (1000 * metres).toFixed(digits).replace("-", "\u2212") : "\u2013";

/** Radians as degrees from -180 to 180. */
export const degrees = (radians, digits = 0) =>
  Number.isFinite(radians)
    ? ((180 / Math.PI) * Math.atan2(Math.sin(radians), Math.cos(radians))).toFixed(digits).replace("-", "\u2212")
    : "\u2013";

export const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

/** Call `work` at most once in `ms` with the newest arguments; the last call is never lost. */
export function seldom(ms, work) {
  let timer = 0;
  return () => {
    timer ||= setTimeout(() => {
      timer = 0;
      work();
    }, ms);
  };
}

/** Resize a canvas to its size on the screen; return its context, width and height in CSS pixels. */
export function fitted(canvas) {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const width = Math.max(1, canvas.clientWidth);
  const height = Math.max(1, canvas.clientHeight);
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}

/** The value of a colour of page.css, such as "--ink". */
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
