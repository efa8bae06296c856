"use strict";
const SVG = "http://www.w3.org/2000/svg";
const POINT_PX = 1.25; // pixels of a point of print
const NEAR_PX = 28; // from the pointer to a point that is named
const DRAG_PX = 8; // a shorter way of the pointer is a click
const FLAT_PX = 24; // a lower box zooms along the horizontal axis alone
const LETTER_PX = 6.6; // of an axis, on average
const PRINTED_WIDTH = "700px"; // of a sheet of A4 between its margins
const PRINTED_HEIGHT = 0.65; // of the height on a screen
const MARGIN = { top: 6, right: 16, bottom: 20 }; // pixels around a panel
const NAMED = { ink: "var(--ink)", soft: "var(--soft)", bad: "var(--bad)", paper: "var(--paper)", none: "none" };

function element(name, attributes, parent, text) {
  const made = attributes.html ? document.createElement(name) : document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) if (key !== "html") made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

function paint(colour) {
  return NAMED[colour] || colour;
}

function decoded(text) {
  return Array.isArray(text) ? text : new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}

/** Places of about `count` round numbers between two limits. */
function roundNumbers([low, high], count, log) {
  const found = [];
  if (log) {
    const decades = Math.log10(high / low);
    const [steps, each] = [decades > 3 ? [1] : [1, 2, 5], Math.max(Math.ceil(decades / count), 1)];
    for (let power = each * Math.floor(Math.log10(low) / each); power <= Math.log10(high); power += each) {
      for (const step of steps) found.push(step * 10 ** power);
    }
    return found.filter((value) => value >= low && value <= high);
  }
  const rough = (high - low) / Math.max(count, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= rough);
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return found;
}

/** A number with as many digits as a span of the axis shows. */
function shortNumber(value, span) {
  const digits = Math.max(0, Math.min(6, Math.ceil(-Math.log10(span) - 0.01)));
  return Math.abs(span) < 1e-6 ? value.toPrecision(3) : value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1");
}

/** "error [m]" and a number: "error: 1.23 m". */
function said(label, number) {
  const [, name, unit] = /^(.*?)(?: \[(.*)\])?$/.exec(label.replace(/ \((largest|logarithmic).*\)$/, ""));
  return `${name || "value"}: ${number}${unit ? ` ${unit}` : ""}`;
}

/** The shape of a mark, relative to its middle; `h` is half its size. */
function outline(marker, h) {
  const two = 2 * h;
  const shapes = {
    x: `m${-h} ${-h}l${two} ${two}m0 ${-two}l${-two} ${two}`, s: `m${-h} ${-h}h${two}v${two}h${-two}z`,
    D: `m0 ${-h}l${h} ${h}l${-h} ${h}l${-h} ${-h}z`, "^": `m0 ${-h}l${h} ${two}h${-two}z`,
    v: `m0 ${h}l${h} ${-two}h${-two}z`, "+": `m${-h} 0h${two}m${-h} ${-h}v${two}`,
    _: `m${-h} 0h${two}`, "|": `m0 ${-h}v${two}`,
  };
  return shapes[marker] || `m${-h} 0a${h} ${h} 0 1 0 ${two} 0a${h} ${h} 0 1 0 ${-two} 0`;
}

/** Whether a mark is a dot of one colour. */
function isDot(mark) {
  return (mark.marker === "." || mark.marker === "o") && mark.face === mark.edge;
}

function halfOf(mark) {
  const size = mark.size * (mark.marker === "." ? 0.5 : 1) + (isDot(mark) ? mark.line : 0);
  return Math.max((size * POINT_PX) / 2, 1);
}

/** One panel: axes, what is drawn in them, and what the pointer does. */
class Panel {
  constructor(data, figure, column) {
    Object.assign(this, { data, figure, view: { x: data.x.limits, y: data.y.limits } });
    this.title = element("p", { html: 1, class: "panel-title" }, column, data.title);
    const label = `${data.title} ${data.y.label}; ${data.x.label}`;
    this.svg = element("svg", { role: "img", tabindex: 0, "aria-label": label }, column);
    for (const [name, call] of [["pointermove", this.move], ["pointerdown", this.down], ["pointerup", this.up],
      ["pointerleave", this.leave], ["focus", () => { figure.active = this; }], ["dblclick", () => figure.reset()]]) {
      this.svg.addEventListener(name, call.bind(this));
    }
  }

  /** Draw for the width of the column. */
  draw(width, last) {
    const { data } = this;
    const names = (data.y.ticks || []).map(([, text]) => text.length);
    const letters = names.length ? Math.max(...names) : 6;
    this.left = Math.min(Math.max(letters * LETTER_PX, 40) + 26, width * 0.42);
    const wide = width - this.left - MARGIN.right;
    const below = (data.x.ticks || []).map(([, text]) => text.length);
    const slanted = below.reduce((sum, length) => sum + (length + 2) * LETTER_PX, 0) > wide;
    const under = slanted ? Math.max(...below) * LETTER_PX * 0.6 : 0;
    const foot = last ? MARGIN.bottom + under + (data.x.label ? 18 : 0) : 8;
    const most = data.height * this.figure.scale;
    const high = data.equal ? Math.min(wide, most) : most;
    Object.assign(this, { wide, high, width, slanted, height: high + MARGIN.top + foot });
    this.view = this.fitted(this.view);
    this.svg.setAttribute("viewBox", `0 0 ${width} ${this.height}`);
    this.svg.replaceChildren();
    this.drawAxes(last);
    const id = `clip-${this.figure.name}-${this.figure.panels.indexOf(this)}`;
    const clip = element("clipPath", { id }, element("defs", {}, this.svg));
    element("rect", { x: this.left, y: MARGIN.top, width: wide, height: high }, clip);
    const inside = element("g", { "clip-path": `url(#${id})`, class: "data" }, this.svg);
    for (const mark of data.marks) if (!this.figure.hidden.has(mark.key)) this.drawMark(mark, inside);
    this.over = element("g", {}, this.svg);
  }

  /** The view with metres as long upwards as across, if the panel is a plane. */
  fitted(view) {
    if (!this.data.equal) return view;
    const perPx = Math.max((view.x[1] - view.x[0]) / this.wide, (view.y[1] - view.y[0]) / this.high);
    const around = ([low, high], px) => [(low + high - perPx * px) / 2, (low + high + perPx * px) / 2];
    return { x: around(view.x, this.wide), y: around(view.y, this.high) };
  }

  share(axis, value) {
    const [low, high] = this.view[axis];
    return this.data[axis].log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  }

  px(value) {
    return this.left + this.wide * this.share("x", value);
  }

  py(value) {
    return MARGIN.top + this.high * (1 - this.share("y", value));
  }

  /** The number of an axis at a share of its length. */
  valueAt(axis, share) {
    const [low, high] = this.view[axis];
    return this.data[axis].log ? low * (high / low) ** share : low + share * (high - low);
  }

  ticks(axis, count) {
    const { ticks, log } = this.data[axis];
    const [low, high] = this.view[axis];
    if (ticks) return ticks.filter(([at]) => at >= Math.min(low, high) && at <= Math.max(low, high));
    const found = roundNumbers([low, high], count, log);
    const step = found.length > 1 ? found[1] - found[0] : high - low;
    const power = (at) => (at < 1e6 ? String(+at.toPrecision(3)) : at.toExponential(0));
    return found.map((at) => [at, log ? power(at) : shortNumber(at, step)]);
  }

  drawAxes(last) {
    const { left, wide, high, data } = this;
    const bottom = MARGIN.top + high;
    const text = (attributes, words) => element("text", attributes, this.svg, words);
    for (const [at, words] of this.ticks("y", high / 30)) {
      const y = this.py(at);
      element("line", { x1: left, x2: left + wide, y1: y, y2: y, class: "grid" }, this.svg);
      const most = Math.floor((left - 24) / LETTER_PX);
      const shown = words.length > most ? `…${words.slice(1 - most)}` : words;
      text({ x: left - 6, y: y + 4, "text-anchor": "end" }, shown);
    }
    for (const [at, words] of this.ticks("x", wide / 55)) {
      const x = this.px(at);
      element("line", { x1: x, x2: x, y1: MARGIN.top, y2: bottom, class: "grid" }, this.svg);
      const turned = this.slanted ? { transform: `rotate(-35 ${x} ${bottom + 12})`, "text-anchor": "end" } : {};
      if (last) text({ x, y: bottom + 16, "text-anchor": "middle", ...turned }, words);
    }
    element("path", { d: `M${left} ${MARGIN.top}V${bottom}H${left + wide}`, class: "frame" }, this.svg);
    if (last) text({ x: left + wide / 2, y: this.height - 4, "text-anchor": "middle" }, data.x.label);
    const middle = MARGIN.top + high / 2;
    text({ x: 11, y: middle, "text-anchor": "middle", transform: `rotate(-90 11 ${middle})` }, data.y.label);
  }

  drawMark(mark, parent) {
    const [top, bottom] = [MARGIN.top, MARGIN.top + this.high];
    const stroke = {
      fill: "none", stroke: paint(mark.colour), "stroke-width": (mark.width || 1) * POINT_PX, opacity: mark.alpha,
      "stroke-dasharray": mark.dash || "none", "stroke-linejoin": "round",
    };
    const fill = { fill: paint(mark.colour), opacity: mark.alpha };
    if (mark.kind === "shade") {
      const [from, to] = [mark.from, mark.to].map((at) => (mark.axis === "x" ? this.px(at) : this.py(at)));
      const [first, width] = [Math.min(from, to), Math.max(Math.abs(to - from), 1)];
      const box = mark.axis === "x" ? { x: first, width, y: top, height: this.high }
        : { x: this.left, width: this.wide, y: first, height: width };
      element("rect", { ...box, fill: paint(mark.colour) }, parent);
    } else if (mark.kind === "rule") {
      const d = "down" in mark ? `M${this.px(mark.down)} ${top}V${bottom}`
        : `M${this.left} ${this.py(mark.across)}H${this.left + this.wide}`;
      element("path", { ...stroke, d }, parent);
    } else if (mark.kind === "band") {
      element("path", { ...fill, d: this.band(mark) }, parent);
    } else if (mark.kind === "area") {
      element("path", { ...fill, d: `${this.way(mark)}Z` }, parent);
    } else if (mark.kind === "text") {
      const at = { x: this.px(mark.at[0]), y: this.py(mark.at[1]) - 7, "text-anchor": "middle" };
      element("text", at, parent, mark.text);
    } else if (mark.kind === "scale") {
      mark.colours.forEach((colour, k) => element("path", { ...stroke, stroke: colour, d: this.part(mark, k) }, parent));
    } else {
      if (mark.kind === "line") element("path", { ...stroke, d: this.way(mark) }, parent);
      if (mark.marker) this.drawPoints(mark, parent);
    }
  }

  way(mark) {
    const [x, y] = this.figure.xy(mark);
    const parts = [];
    let pen = "M";
    for (let k = 0; k < x.length; k++) {
      const [a, b] = this.place(mark, x[k], y[k]);
      if (!Number.isFinite(a + b)) { pen = "M"; continue; }
      parts.push(`${pen}${a.toFixed(1)} ${b.toFixed(1)}`);
      pen = "L";
    }
    return parts.join("");
  }

  band(mark) {
    const { numbers } = this.figure;
    const [x, low, high] = [numbers[mark.x], numbers[mark.low], numbers[mark.high]];
    const parts = [];
    for (let from = 0, k = 0; k <= x.length; k++) {
      if (k < x.length && Number.isFinite(x[k] + low[k] + high[k])) continue;
      const at = (j, y) => `${this.px(x[j]).toFixed(1)} ${this.py(y[j]).toFixed(1)}`;
      const rows = Array.from({ length: k - from }, (_, j) => from + j);
      if (rows.length) {
        parts.push(`M${[...rows.map((j) => at(j, low)), ...rows.reverse().map((j) => at(j, high))].join("L")}Z`);
      }
      from = k + 1;
    }
    return parts.join("");
  }

  part(mark, shade) {
    const { numbers } = this.figure;
    const [x1, y1, x2, y2] = mark.ends.map((place) => numbers[place]);
    const [low, high] = mark.limits;
    const most = mark.colours.length - 1;
    return Array.from(numbers[mark.value], (value, k) => {
      const mine = Math.min(Math.max(Math.round((most * (value - low)) / (high - low || 1)), 0), most);
      if (mine !== shade) return "";
      const ends = [this.px(x1[k]), this.py(y1[k]), this.px(x2[k]), this.py(y2[k])].map((px) => px.toFixed(1));
      return `M${ends[0]} ${ends[1]}L${ends[2]} ${ends[3]}`;
    }).join("");
  }

  /** Where a point is drawn, in pixels; one beyond the axes as they are at first at the edge of any view. */
  place(mark, x, y) {
    let [a, b] = [this.px(x), this.py(y)];
    const inside = (value, [low, high]) => value >= low && value <= high;
    if (mark.beyond && mark.beyond.includes("x") && !inside(x, this.data.x.limits)) {
      a = Math.min(Math.max(a, this.left + 4), this.left + this.wide - 4);
    }
    if (mark.beyond && mark.beyond.includes("y") && !inside(y, this.data.y.limits)) {
      b = Math.min(Math.max(b, MARGIN.top + 4), MARGIN.top + this.high - 4);
    }
    return [a, b];
  }

  drawPoints(mark, parent) {
    const [x, y] = this.figure.xy(mark);
    const half = halfOf(mark);
    const filled = isDot(mark);
    const shape = filled ? "h0" : outline(mark.marker, half);
    const parts = [];
    for (let k = 0; k < x.length; k++) {
      const [a, b] = this.place(mark, x[k], y[k]);
      if (!(a > -9 && b > -9 && a < this.width + 9 && b < this.height + 9)) continue;
      parts.push(`M${a.toFixed(1)} ${b.toFixed(1)}${shape}`);
    }
    const stroke = filled ? { stroke: paint(mark.face), "stroke-width": 2 * half, "stroke-linecap": "round" }
      : { stroke: paint(mark.edge), "stroke-width": Math.max(mark.line, 0.8) * POINT_PX };
    const face = filled || mark.face === "none" || "x_|+".includes(mark.marker) ? "none" : paint(mark.face);
    element("path", { d: parts.join(""), fill: face, opacity: mark.alpha, ...stroke }, parent);
  }

  at(event) {
    const box = this.svg.getBoundingClientRect();
    const scale = this.width / box.width;
    return [(event.clientX - box.left) * scale, (event.clientY - box.top) * scale];
  }

  /** The nearest point of what is drawn. */
  nearest(a, b) {
    let best = null;
    for (const mark of this.data.marks) {
      if (!("rows" in mark) || mark.mute || this.figure.hidden.has(mark.key)) continue;
      const [x, y] = this.figure.xy(mark);
      for (let k = 0; k < x.length; k++) {
        const [p, q] = this.place(mark, x[k], y[k]);
        const away = Math.hypot(p - a, q - b);
        if (away <= (best ? best.away : NEAR_PX)) best = { mark, k, away, at: [p, q], x: x[k], y: y[k] };
      }
    }
    return best;
  }

  move(event) {
    const [a, b] = this.at(event);
    this.over.replaceChildren();
    this.figure.tip.hidden = true;
    this.figure.active = this;
    if (this.start) {
      const [c, d] = this.start;
      const box = { x: Math.min(a, c), y: Math.min(b, d), width: Math.abs(a - c), height: Math.abs(b - d) };
      if (!this.pans) element("rect", { ...box, class: "box" }, this.over);
      return;
    }
    const found = this.nearest(a, b);
    if (!found) return;
    element("circle", { cx: found.at[0], cy: found.at[1], r: 5, class: "spot" }, this.over);
    this.figure.tell(this, found, event);
  }

  down(event) {
    const touch = event.pointerType === "touch";
    if (touch) this.move(event);
    if (event.button || (touch && !this.figure.zoomed)) return;
    Object.assign(this, { start: this.at(event), pans: touch || event.shiftKey });
    this.svg.setPointerCapture(event.pointerId);
  }

  up(event) {
    const [start, end] = [this.start, this.at(event)];
    this.start = null;
    if (!start || Math.hypot(end[0] - start[0], end[1] - start[1]) < DRAG_PX) return;
    const shares = [start, end].map(([a, b]) => [(a - this.left) / this.wide, 1 - (b - MARGIN.top) / this.high]);
    const spans = ["x", "y"].map((axis, k) => [shares[0][k], shares[1][k]]);
    if (this.pans) {
      this.show(...spans.map(([from, to]) => [from - to, 1 + from - to]));
    } else {
      const flat = Math.abs(end[1] - start[1]) < FLAT_PX && !this.data.equal;
      this.show(spans[0].sort((p, q) => p - q), flat ? [0, 1] : spans[1].sort((p, q) => p - q));
    }
  }

  /** Show a part of the view, in shares of its axes; linked panels follow along the horizontal axis. */
  show(across, upwards) {
    const x = across.map((share) => this.valueAt("x", share));
    const y = upwards.map((share) => this.valueAt("y", share));
    for (const panel of this.figure.panels) {
      if (panel.data.linked === this.data.linked) panel.view = { x, y: panel === this ? y : panel.view.y };
    }
    this.figure.zoomed = true;
    this.figure.draw();
  }

  leave(event) {
    this.start = null;
    if (event.pointerType === "touch") return; // what a finger pointed at stays when it is lifted
    if (this.over) this.over.replaceChildren();
    this.figure.tip.hidden = true;
  }
}

/** A figure: columns of panels, buttons, legend, and the words at the pointer. */
class Figure {
  constructor(box, name, data) {
    Object.assign(this, { box, name, scale: 1, hidden: new Set(), numbers: data.numbers.map(decoded), panels: [] });
    box.replaceChildren();
    const tools = element("div", { html: 1, class: "tools" }, box);
    for (const [text, label, call] of [["+", "zoom in", () => this.zoom(0.25)], ["−", "zoom out", () => this.zoom(-0.5)],
      ["reset", "show all; drag to zoom, drag with Shift or press arrow keys to move", () => this.reset()]]) {
      const button = element("button", { html: 1, type: "button", "aria-label": label, title: label }, tools, text);
      button.addEventListener("click", call);
    }
    const row = element("div", { html: 1, class: "columns" }, box);
    this.columns = data.columns.map(({ width, panels }) => {
      const column = element("div", { html: 1, class: "column", style: `--share: ${width}` }, row);
      const made = panels.map((panel) => new Panel(panel, this, column));
      this.panels.push(...made);
      return { column, panels: made };
    });
    box.addEventListener("keydown", (event) => {
      const ways = { ArrowLeft: [-0.2, 0], ArrowRight: [0.2, 0], ArrowUp: [0, 0.2], ArrowDown: [0, -0.2] };
      if (!ways[event.key]) return;
      event.preventDefault();
      (this.active || this.panels[0]).show(...ways[event.key].map((part) => [part, 1 + part]));
    });
    this.legend = element("div", { html: 1, class: "legend" }, box);
    this.tip = element("div", { html: 1, class: "tip", role: "status" }, box);
    this.tip.hidden = true;
    this.drawLegend();
    this.draw();
    const fit = () => { if (box.clientWidth && box.clientWidth !== this.drawnWidth) this.draw(); };
    new ResizeObserver(() => requestAnimationFrame(fit)).observe(box);
  }

  xy(mark) {
    return [this.numbers[mark.x], this.numbers[mark.y]];
  }

  draw() {
    this.drawnWidth = this.box.clientWidth;
    this.alignTitles();
    for (const { column, panels } of this.columns) {
      panels.forEach((panel, k) => {
        const below = panels[k + 1];
        panel.draw(Math.max(column.clientWidth, 240), !below || below.data.linked !== panel.data.linked);
      });
    }
  }

  /** Give the titles of panels beside each other the height of the highest. */
  alignTitles() {
    const beside = new Set(this.columns.map(({ column }) => column.offsetTop)).size === 1;
    const rows = new Set(this.columns.map(({ panels }) => panels.length));
    for (let k = 0; k < (rows.size === 1 ? Math.max(...rows) : 1); k++) {
      const titles = this.columns.map(({ panels }) => panels[k].title);
      for (const title of titles) title.style.minHeight = "";
      const high = Math.max(0, ...titles.map((title) => title.offsetHeight));
      if (beside) for (const title of titles) title.style.minHeight = `${high}px`;
    }
  }

  zoom(part) {
    const panel = this.active || this.panels[0];
    const span = [part, 1 - part];
    panel.show(span, panel.data.equal ? span : [0, 1]);
  }

  reset() {
    for (const panel of this.panels) panel.view = { x: panel.data.x.limits, y: panel.data.y.limits };
    this.zoomed = false;
    this.draw();
  }

  drawLegend() {
    const marks = new Map();
    for (const panel of this.panels) {
      for (const mark of panel.data.marks) if (mark.label && !marks.has(mark.label)) marks.set(mark.label, mark);
    }
    for (const [label, mark] of marks) {
      const entry = element("button", { html: 1, type: "button", "aria-pressed": "true" }, this.legend);
      entry.append(sample(mark));
      element("span", { html: 1 }, entry, label);
      entry.addEventListener("click", () => {
        const off = !this.hidden.delete(mark.key);
        if (off) this.hidden.add(mark.key);
        entry.setAttribute("aria-pressed", String(!off));
        this.draw();
      });
    }
    for (const mark of this.panels.flatMap((panel) => panel.data.marks).filter((one) => one.kind === "scale")) {
      const scale = element("span", { html: 1, class: "scale" }, this.legend);
      element("span", { html: 1 }, scale, `${mark.name}: ${mark.limits[0].toFixed(2)}`);
      const bar = element("svg", { width: 96, height: 10 }, scale);
      mark.colours.forEach((fill, k) => element("rect", { x: 6 * k, width: 6.5, height: 10, fill }, bar));
      element("span", { html: 1 }, scale, `${mark.limits[1].toFixed(2)} and more`);
    }
  }

  /** Say what is at the pointer. */
  tell(panel, found, event) {
    const { data, view } = panel;
    const across = this.panels.find((one) => one.data.linked === data.linked && one.data.x.label) || panel;
    const lines = [["x", across.data.x.label], ["y", data.y.label]].map(([axis, label]) => {
      const [value, span] = [found[axis], Math.abs(view[axis][1] - view[axis][0])];
      const name = (data[axis].ticks || []).find(([at, text]) => Math.abs(at - value) < 0.5 && Number.isNaN(+text));
      return name ? name[1] : said(label, shortNumber(value, span / 500));
    });
    for (const [label, place] of found.mark.rows) {
      const value = this.numbers[place][found.k];
      if (Number.isNaN(value)) continue;
      lines.push(said(label, typeof value === "string" || Number.isInteger(value) ? value : value.toFixed(2)));
    }
    this.tip.replaceChildren();
    if (found.mark.key) element("b", { html: 1 }, this.tip, found.mark.key);
    for (const line of lines) element("div", { html: 1 }, this.tip, line);
    this.tip.hidden = false;
    const box = this.box.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const right = x + 18 + this.tip.offsetWidth > box.width;
    this.tip.style.left = `${Math.max(right ? x - 14 - this.tip.offsetWidth : x + 14, 0)}px`;
    this.tip.style.top = `${Math.max(y - this.tip.offsetHeight - 8, 0)}px`;
  }
}

/** What an entry of the legend looks like. */
function sample(mark) {
  const svg = element("svg", { width: 24, height: 12, "aria-hidden": "true" });
  const colour = paint(mark.colour);
  if (["shade", "area", "band"].includes(mark.kind)) {
    const opacity = mark.kind === "shade" ? 1 : Math.max(mark.alpha, 0.2);
    element("rect", { width: 24, height: 12, fill: colour, opacity }, svg);
    return svg;
  }
  if (mark.kind !== "points") {
    const dash = mark.dash || "none";
    const width = Math.max((mark.width || 1) * POINT_PX, 1.2);
    element("path", { d: "M0 6H24", stroke: colour, "stroke-width": width, "stroke-dasharray": dash }, svg);
  }
  if (mark.marker) {
    const face = "x+".includes(mark.marker) ? "none" : paint(mark.face);
    const d = `M12 6${outline(mark.marker, Math.min(Math.max(halfOf(mark), mark.kind === "points" ? 2.5 : 1), 5))}`;
    element("path", { d, fill: face, stroke: paint(mark.edge), "stroke-width": 1 }, svg);
  }
  return svg;
}

const plots = Object.entries(JSON.parse(document.getElementById("plot-data").textContent));
const figures = plots.map(([name, data]) => new Figure(document.getElementById(`plot-${name}`), name, data));
for (const [event, width, scale] of [["beforeprint", PRINTED_WIDTH, PRINTED_HEIGHT], ["afterprint", "", 1]]) {
  addEventListener(event, () => figures.forEach((one) => {
    one.box.style.width = width;
    one.scale = scale;
    one.draw();
  }));
}
document.documentElement.dataset.ready = "yes";
