"use strict";
// A line chart with bands, names at the line ends and a reading under the pointer. It knows nothing of agents.

const SVG = document.getElementById("seed").namespaceURI;

function draw(tag, attributes, parent) {
  const node = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  if (parent) parent.append(node);
  return node;
}

function formatNumber(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1000) return Math.round(value).toLocaleString("en").replace("-", "\u2212");
  return String(Number(value.toPrecision(size < 0.1 ? 1 : 3))).replace("-", "\u2212");
}

function makeScale(low, high, from, to, isLog) {
  const bend = isLog ? Math.log10 : (v) => v;
  const a = bend(low), b = bend(high);
  const scale = (v) => from + ((bend(v) - a) / (b - a || 1)) * (to - from);
  scale.invert = (p) => { const t = a + ((p - from) / (to - from)) * (b - a); return isLog ? 10 ** t : t; };
  return scale;
}

function listTicks(low, high, isLog, count) {
  if (isLog) {
    const ticks = [];
    const wide = Math.log10(high / low);
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++)
      for (const digit of wide > 2.2 ? [1] : [1, 2, 5]) {
        const tick = digit * 10 ** power;
        if (tick >= low * 0.999 && tick <= high * 1.001) ticks.push(tick);
      }
    return ticks;
  }
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((m) => m * power).find((s) => s >= rough) || power * 10;
  const ticks = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9; i++) ticks.push(Number((i * step).toPrecision(12)));
  return ticks;
}

// Moves labels apart along y, as little as it takes, in order, and between low and high while they fit.
function spread(places, gap, low, high) {
  const order = places.map((_, i) => i).sort((a, b) => places[a] - places[b]);
  const at = order.map((i) => places[i]);
  for (let pass = 0; pass < 60; pass++)
    for (let i = 1; i < at.length; i++) {
      const lack = gap - (at[i] - at[i - 1]);
      if (lack > 0) { at[i - 1] -= lack / 2; at[i] += lack / 2; }
    }
  for (let i = 0; i < at.length; i++) at[i] = Math.max(at[i], i ? at[i - 1] + gap : low);
  for (let i = at.length - 1; i >= 0; i--) at[i] = Math.min(at[i], i < at.length - 1 ? at[i + 1] - gap : high);
  const result = [];
  order.forEach((i, rank) => { result[i] = at[rank]; });
  return result;
}

// series: [{name, colour, dash, thin, x, y, low, high}], a thin one without band; options: {width, height, xTitle, yTitle, xLog, yLog, xReverse, yReverse,
// xRange, yRange, step, names, xFormat, yFormat}
function drawChart(box, series, options) {
  box.replaceChildren();
  const width = options.width, height = options.height;
  const longest = Math.max(0, ...series.map((s) => s.name.length));
  const named = options.names && width > 620; // below that the legend has to do
  const left = 62, right = named ? Math.min(0.42 * width, 40 + 7.4 * longest) : 20, top = 18, bottom = 46;
  const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, role: "img" }, box);
  const xs = series.flatMap((s) => s.x), ys = series.flatMap((s) => [...s.low, ...s.high, ...s.y]);
  let [xLow, xHigh] = options.xRange || [Math.min(...xs, 0), Math.max(...xs)];
  let [yLow, yHigh] = options.yRange || [Math.min(...ys), Math.max(...ys)];
  if (!series.length) [xLow, xHigh, yLow, yHigh] = [0, 1, 0, 1];
  const X = makeScale(xLow, xHigh, ...(options.xReverse ? [width - right, left] : [left, width - right]), options.xLog);
  const Y = makeScale(yLow, yHigh, ...(options.yReverse ? [top, height - bottom] : [height - bottom, top]), options.yLog);
  const showX = options.xFormat || formatNumber, showY = options.yFormat || formatNumber;

  const axis = draw("g", { class: "axis" }, svg);
  for (const tick of listTicks(yLow, yHigh, options.yLog, 5)) {
    draw("line", { x1: left, x2: width - right, y1: Y(tick), y2: Y(tick) }, axis);
    draw("text", { x: left - 9, y: Y(tick) + 4, "text-anchor": "end" }, axis).textContent = showY(tick);
  }
  for (const tick of listTicks(xLow, xHigh, options.xLog, width > 700 ? 8 : 5))
    draw("text", { x: X(tick), y: height - bottom + 19, "text-anchor": "middle" }, axis).textContent = showX(tick);
  draw("text", { x: (left + width - right) / 2, y: height - 8, "text-anchor": "middle", class: "title" }, svg)
    .textContent = options.xTitle;
  draw("text", { transform: `translate(15 ${(top + height - bottom) / 2}) rotate(-90)`, "text-anchor": "middle", class: "title" }, svg)
    .textContent = options.yTitle;

  const clampY = (v) => Math.min(Math.max(v, yLow), yHigh);
  const trace = (x, y) => x.map((v, i) => {
    const point = `${X(v).toFixed(1)},${Y(clampY(y[i])).toFixed(1)}`;
    return i && options.step ? `${X(v).toFixed(1)},${Y(clampY(y[i - 1])).toFixed(1)} ${point}` : point;
  }).join(" ");
  for (const s of series.filter((s) => s.low !== s.high && !s.thin))
    draw("polygon", { points: `${trace(s.x, s.high)} ${trace([...s.x].reverse(), [...s.low].reverse())}`, fill: s.colour, "fill-opacity": 0.13 }, svg);
  for (const s of series)
    draw("polyline", { points: trace(s.x, s.y), fill: "none", stroke: s.colour, "stroke-width": s.thin ? 1.1 : 2.2,
      "stroke-dasharray": s.dash ? "6 4" : "none", "stroke-linejoin": "round", "stroke-linecap": s.dash ? "butt" : "round" }, svg);

  if (named) {
    const places = spread(series.map((s) => Y(clampY(s.y[s.y.length - 1]))), 17, top, height - bottom);
    series.forEach((s, i) => {
      const endX = X(s.x[s.x.length - 1]), endY = Y(clampY(s.y[s.y.length - 1])), nameX = width - right + 14;
      draw("path", { d: `M${endX + 4},${endY} H${nameX - 12} L${nameX - 4},${places[i]}`, fill: "none", stroke: s.colour,
        "stroke-width": 1, "stroke-opacity": 0.45, "stroke-dasharray": "1 3" }, svg);
      draw("text", { x: nameX, y: places[i] + 4, fill: s.text || s.colour, class: s.thin ? "name thin" : "name" }, svg).textContent = s.name;
    });
  }
  if (series.length) read(box, svg, series, X, { left, right, top, bottom, width, height, showX, showY, options });
}

function interpolate(s, x, step) {
  const n = s.x.length;
  if (x > s.x[n - 1] * 1.0001) return null;
  let i = s.x.findIndex((v) => v >= x);
  if (i <= 0) return s.y[0];
  if (step) return s.x[i] === x ? s.y[i] : s.y[i - 1];
  const t = (x - s.x[i - 1]) / (s.x[i] - s.x[i - 1] || 1);
  return s.y[i - 1] + t * (s.y[i] - s.y[i - 1]);
}

// The reading under the pointer.
function read(box, svg, series, X, place) {
  const { left, right, top, bottom, width, height, showX, showY, options } = place;
  const line = draw("line", { y1: top, y2: height - bottom, stroke: "currentColor", "stroke-opacity": 0.35, visibility: "hidden" }, svg);
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  box.append(tip);
  svg.addEventListener("pointermove", (event) => {
    const bounds = svg.getBoundingClientRect(), zoom = width / bounds.width;
    const at = (event.clientX - bounds.left) * zoom;
    if (at < left || at > width - right) return hide();
    const x = X.invert(at);
    const rows = series.map((s) => [s, interpolate(s, x, options.step)]).filter(([, y]) => y !== null);
    rows.sort((a, b) => (options.yReverse ? a[1] - b[1] : b[1] - a[1]));
    line.setAttribute("x1", at);
    line.setAttribute("x2", at);
    line.setAttribute("visibility", "visible");
    tip.replaceChildren();
    const head = document.createElement("div");
    head.className = "at";
    head.textContent = `${showX(x)} ${options.xUnit || ""}`;
    tip.append(head);
    for (const [s, y] of rows) {
      const row = document.createElement("div"), value = document.createElement("b");
      row.style.color = s.text || s.colour;
      row.textContent = s.name;
      value.textContent = (options.tipFormat || showY)(y);
      row.append(value);
      tip.append(row);
    }
    tip.hidden = false;
    const spot = (event.clientX - bounds.left);
    tip.style.left = `${spot > bounds.width / 2 ? spot - tip.offsetWidth - 16 : spot + 16}px`;
    tip.style.top = `${Math.max(6, event.clientY - bounds.top - tip.offsetHeight / 2)}px`;
  });
  svg.addEventListener("pointerleave", hide);
  function hide() { tip.hidden = true; line.setAttribute("visibility", "hidden"); }
}
