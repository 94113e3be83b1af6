// Draws every panel with the JSON beside it; a button of a chart's key shows or hides its kind.
"use strict";
const settings = {
  responsive: true, displaylogo: false, modeBarButtons: [["toImage", "resetScale2d"]],
};
for (const panel of document.querySelectorAll(".panel")) {
  const figure = JSON.parse(panel.nextElementSibling.textContent);
  Plotly.newPlot(panel, figure.data, figure.layout, settings);
}
for (const button of document.querySelectorAll(".key button")) {
  button.addEventListener("click", () => {
    const shown = button.getAttribute("aria-pressed") === "false";
    button.setAttribute("aria-pressed", String(shown));
    for (const panel of button.closest("section").querySelectorAll(".panel")) {
      const mine = panel.data.flatMap((trace, k) => (trace.name === button.dataset.name ? [k] : []));
      if (mine.length) Plotly.restyle(panel, { visible: shown }, mine);
    }
  });
}
