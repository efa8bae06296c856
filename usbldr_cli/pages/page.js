"use strict";
const NARROW_PX = 640; // as in the style: the width of a phone
const PALETTES = {
  light: { ink: "#17202a", soft: "#55606b", rule: "#e3e7eb", shade: 0.5, alarm: "#cc0000" },
  dark: { ink: "#e6eaee", soft: "#a3adb8", rule: "#2b333c", shade: 0.12, alarm: "#ff6b5e" },
};
const dark = window.matchMedia("(prefers-color-scheme: dark)");

function models() {
  return Bokeh.documents.flatMap((page) => [...page.all_models]);
}

/** Give axes, grids, legends and lines of the truth the colours of the page. */
function paint(palette) {
  for (const model of models()) {
    if (model.type.endsWith("Axis")) {
      model.setv({
        axis_line_color: palette.soft, major_tick_line_color: palette.soft, minor_tick_line_color: palette.soft,
        major_label_text_color: palette.soft, axis_label_text_color: palette.soft,
      });
    } else if (model.type === "Grid") {
      model.setv({ grid_line_color: palette.rule });
    } else if (model.type === "Legend") {
      model.setv({ label_text_color: palette.ink });
    } else if (model.type === "Title") {
      model.setv({ text_color: palette.ink });
    } else if (model.type === "BoxAnnotation" && model.tags.includes("shade")) {
      model.setv({ fill_alpha: palette.shade });
    } else if (model.tags.includes("ink")) {
      model.setv({ line_color: palette.ink });
    } else if (model.tags.includes("alarm")) {
      model.setv({ line_color: palette.alarm });
    }
  }
}

function paintForScreen() {
  paint(dark.matches ? PALETTES.dark : PALETTES.light);
  document.documentElement.dataset.scheme = dark.matches ? "dark" : "light"; // on paper, the style inverts dark figures
}

/** On a touch screen a finger scrolls the page until a tool is chosen; a phone gets lower figures. */
function fit() {
  const touch = window.matchMedia("(pointer: coarse)").matches;
  for (const model of models()) {
    if (touch && "active" in model && model.type !== "HoverTool") model.active = false;
    if (window.innerWidth >= NARROW_PX) continue;
    const legend = model.type === "Figure" && model.below.some((part) => part.type === "Legend");
    if (model.type === "Figure" && !legend) model.height = Math.round(model.height * 0.8);
    if (model.type === "Legend") model.ncols = 1;
  }
}

async function start() {
  const figures = JSON.parse(document.getElementById("plot-data").textContent);
  await Promise.all(Object.values(figures).map((item) => Bokeh.embed.embed_item(item)));
  fit();
  paintForScreen();
  document.documentElement.dataset.ready = "yes";
}

dark.addEventListener("change", paintForScreen);
start();
