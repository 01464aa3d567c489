"use strict";
// Draws the figures in the colours of the theme, and anew when that changes.
(() => {
  const figures = JSON.parse(document.getElementById("figures").textContent);
  const palette = JSON.parse(document.getElementById("palette").textContent);
  const isDark = matchMedia("(prefers-color-scheme: dark)");
  const isTouched = matchMedia("(pointer: coarse), (hover: none)");
  const shown = {};

  function coloured(node, colours) {
    if (typeof node === "string") return !node.startsWith("@") ? node : node.startsWith("@speed:") ? speed(node, colours) : colours[node] || node;
    if (Array.isArray(node)) return typeof node[0] === "number" && typeof node[1] !== "string" ? node : node.map((one) => coloured(one, colours));
    if (node === null || typeof node !== "object") return node;
    return Object.fromEntries(Object.entries(node).map(([key, one]) => [key, key === "source" || key === "customdata" ? one : coloured(one, colours)]));
  }

  function speed(name, colours) {
    const place = Number(name.slice(7)) * (colours.speeds.length - 1);
    return colours.speeds[Math.round(place)];
  }

  function draw(name) {
    const place = document.getElementById(name), figure = figures[name];
    if (!place || !figure) return;
    const colours = palette[isDark.matches ? "dark" : "light"];
    const axis = { gridcolor: colours.line, zerolinecolor: colours.line, linecolor: colours.line, fixedrange: isTouched.matches };
    const layout = coloured(figure.layout, colours);
    for (const key of ["xaxis", "yaxis"]) layout[key] = { ...axis, ...layout[key] };
    const data = coloured(figure.data, colours).map((trace) => ({ ...trace, visible: trace.meta === undefined || !figure.views.length || trace.meta === shown[name] }));
    const height = figure.ratio ? Math.min(Math.max(place.clientWidth * figure.ratio, 280) + 60, 720) : figure.height;
    Plotly.react(place, data, {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", height, autosize: true,
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: colours.ink },
      margin: { l: 48, r: 12, t: 8, b: 40 }, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, hovermode: "closest",
      dragmode: isTouched.matches ? false : figure.ratio ? "pan" : "zoom", ...layout,
    }, { responsive: true, displaylogo: false, displayModeBar: isTouched.matches ? false : "hover", scrollZoom: false, modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] });
  }

  function choices(name, place) {
    const views = figures[name].views;
    if (views.length < 2) return;
    const row = document.createElement("div");
    row.className = "views";
    for (const view of views) {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = view;
      button.setAttribute("aria-pressed", String(view === shown[name]));
      button.addEventListener("click", () => {
        shown[name] = view;
        for (const one of row.children) one.setAttribute("aria-pressed", String(one === button));
        draw(name);
      });
      row.append(button);
    }
    place.before(row);
  }

  for (const name of Object.keys(figures)) {
    const place = document.getElementById(name);
    if (!place) continue;
    figures[name].views = figures[name].views || [];
    shown[name] = figures[name].views[0];
    choices(name, place);
    draw(name);
  }
  isDark.addEventListener("change", () => Object.keys(figures).forEach(draw));
})();
