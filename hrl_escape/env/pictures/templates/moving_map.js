"use strict";
// Plays a recorded episode in a room seen from above. Metres, room frame, y upwards.

const STILL = window.matchMedia("(prefers-reduced-motion: reduce)").matches;

function findLast(changes, frame) {
  let value = changes[0][1];
  for (const [from, next] of changes) { if (from > frame) break; value = next; }
  return value;
}

class Player {
  // box: parent element; room, replay: data of the page; looks: colours; compact: without slider and speed.
  constructor(box, room, replay, looks, compact) {
    Object.assign(this, { box, room, replay, looks });
    this.count = replay.frames.x.length - 1;
    this.time = 0;
    this.playing = false;
    this.rate = Math.max(5, this.count / 24); // primitives per second; no episode takes longer than 24 seconds
    this.speed = 1;
    this.ends = [];
    let sum = 0;
    for (const [, duration] of replay.decisions) this.ends.push((sum += duration));
    this.build(compact);
    this.resize();
    new ResizeObserver(() => this.resize()).observe(this.canvas);
    new IntersectionObserver((seen) => { this.visible = seen[0].isIntersecting; }).observe(this.canvas);
  }

  build(compact) {
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Moving map of an episode of ${this.count} primitives`);
    this.canvas.addEventListener("click", () => this.toggle());
    this.strip = document.createElement("div");
    this.strip.className = "strip" + (this.replay.decisions.length > 90 ? " dense" : "");
    for (const [name, duration, ended] of this.replay.decisions) {
      const part = document.createElement("i");
      part.style.flexGrow = duration;
      part.style.background = this.colourOf(name);
      part.title = `${name}, ${duration} primitive${duration === 1 ? "" : "s"}, ${ended}`;
      this.strip.append(part);
    }
    this.strip.addEventListener("click", (event) => {
      const bounds = this.strip.getBoundingClientRect();
      this.show(((event.clientX - bounds.left) / bounds.width) * this.count);
    });
    this.now = document.createElement("div");
    this.now.className = "now";
    this.button = document.createElement("button");
    this.button.addEventListener("click", () => this.toggle());
    this.slider = document.createElement("input");
    Object.assign(this.slider, { type: "range", min: 0, max: this.count, step: "any", value: 0 });
    this.slider.setAttribute("aria-label", "Time");
    this.slider.addEventListener("input", () => { this.pause(); this.show(Number(this.slider.value)); });
    const bar = document.createElement("div");
    bar.className = "bar";
    bar.append(this.button, this.slider);
    if (!compact) {
      const speed = document.createElement("button");
      speed.className = "speed";
      speed.textContent = "1×";
      speed.title = "Speed";
      speed.addEventListener("click", () => {
        this.speed = this.speed >= 4 ? 0.5 : this.speed * 2;
        speed.textContent = `${this.speed}×`;
      });
      bar.append(speed);
    }
    this.box.replaceChildren(this.canvas, this.strip, bar, this.now);
    this.setIcon();
  }

  colourOf(name) {
    const index = this.room.options.indexOf(name);
    return index < 0 ? "#c9c2b4" : this.looks.lines[index % this.looks.lines.length];
  }

  setIcon() {
    this.button.textContent = this.playing ? "❚❚" : "▶";
    this.button.style.fontSize = this.playing ? "9px" : "11px";
    this.button.setAttribute("aria-label", this.playing ? "Pause" : "Play");
  }

  toggle() { this.playing ? this.pause() : this.play(); }

  play() {
    if (this.playing) return;
    if (this.time >= this.count) this.time = 0;
    this.playing = true;
    this.setIcon();
    let last = performance.now();
    const step = (now) => {
      if (!this.playing || !this.canvas.isConnected) return;
      const passed = Math.min(0.1, (now - last) / 1000);
      last = now;
      if (this.visible !== false) {
        this.show(Math.min(this.count, this.time + passed * this.rate * this.speed));
        if (this.time >= this.count) {
          if (!this.loops) return this.pause();
          this.rest = (this.rest || 0) + passed;
          if (this.rest > 1.6) { this.rest = 0; this.time = 0; }
        }
      }
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  pause() { this.playing = false; this.setIcon(); }

  resize() {
    const { x_min, x_max, y_min, y_max } = this.room.extent;
    const width = this.canvas.clientWidth || 330, pad = 0.35;
    const height = Math.round((width * (y_max - y_min + 2 * pad)) / (x_max - x_min + 2 * pad));
    const dense = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * dense);
    this.canvas.height = Math.round(height * dense);
    this.canvas.style.height = `${height}px`;
    this.zoom = this.canvas.width / (x_max - x_min + 2 * pad);
    this.left = x_min - pad;
    this.top = y_max + pad;
    this.show(this.time);
  }

  show(time) {
    this.time = Math.max(0, Math.min(this.count, time));
    this.slider.value = this.time;
    this.paint();
    const frame = Math.round(this.time);
    const decision = this.ends.findIndex((end) => end >= Math.max(1, Math.ceil(this.time)));
    const name = this.replay.decisions.length ? this.replay.decisions[Math.max(0, decision)][0] : "";
    const left = document.createElement("b");
    left.textContent = name;
    const right = document.createElement("span");
    right.textContent = `primitive ${frame.toLocaleString("en")} of ${this.count.toLocaleString("en")}`;
    this.now.replaceChildren(left, right);
  }

  pose() {
    const { x, y, heading } = this.replay.frames;
    const i = Math.min(Math.floor(this.time), this.count), j = Math.min(i + 1, this.count), t = this.time - i;
    let turn = heading[j] - heading[i];
    turn -= 2 * Math.PI * Math.round(turn / (2 * Math.PI));
    return { i, j, t, x: x[i] + t * (x[j] - x[i]), y: y[i] + t * (y[j] - y[i]), heading: heading[i] + t * turn };
  }

  paint() {
    const c = this.canvas.getContext("2d"), look = this.looks, room = this.room, frames = this.replay.frames;
    const at = this.pose();
    const lit = new Set(findLast(frames.lit, at.i)), open = findLast(frames.open, at.i);
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = "#efe9dd";
    c.fillRect(0, 0, this.canvas.width, this.canvas.height);
    c.setTransform(this.zoom, 0, 0, -this.zoom, -this.left * this.zoom, this.top * this.zoom);
    const metre = 1 / this.zoom * (window.devicePixelRatio || 1); // one CSS pixel

    c.fillStyle = look.floor;
    for (const [x, y, wide, high] of room.floors) c.fillRect(x, y, wide, high);
    const [ex, ey, ew, eh] = room.exit;
    c.fillStyle = open ? look.exitOpen : look.exitLocked;
    c.globalAlpha = open ? 0.45 : 0.3;
    c.fillRect(ex, ey, ew, eh);
    c.globalAlpha = 1;
    c.strokeStyle = open ? look.exitOpen : look.exitLocked;
    c.lineWidth = 1.5 * metre;
    c.setLineDash(open ? [] : [5 * metre, 3 * metre]);
    c.strokeRect(ex, ey, ew, eh);
    c.setLineDash([]);
    for (const puddle of room.puddles || []) {
      c.beginPath();
      for (const [x, y] of puddle) c.lineTo(x, y);
      c.fillStyle = look.puddle;
      c.globalAlpha = 0.6;
      c.fill();
      c.globalAlpha = 1;
    }
    for (const plate of room.props.filter((p) => p.kind === "plate")) this.box_(c, plate, look.plate, look.propEdge, metre);
    for (const solid of room.solids) this.solid(c, solid, solid.role === "wall" ? look.wall : look.obstacle);
    if (room.door && !open) this.solid(c, room.door, look.door);
    const shut = new Set(frames.shut ? findLast(frames.shut, at.i) : []);
    (room.inner_doors || []).forEach((door, index) => {
      if (shut.has(index)) this.solid(c, door, door.role === "door" ? look.door : look.prop);
    });

    c.lineJoin = c.lineCap = "round";
    c.strokeStyle = look.trail;
    c.globalAlpha = 0.5;
    c.lineWidth = 1.6 * metre;
    c.beginPath();
    for (let i = Math.max(0, at.i - 400); i <= at.i; i++) c.lineTo(frames.x[i], frames.y[i]);
    c.lineTo(at.x, at.y);
    c.stroke();
    c.globalAlpha = 1;

    room.targets.forEach((target, index) => {
      const [fill, edge] = lit.has(index) ? look.lit : look.off;
      if (lit.has(index)) {
        c.shadowColor = look.lit[0];
        c.shadowBlur = 14 * (window.devicePixelRatio || 1);
      }
      this.outline(c, target);
      c.fillStyle = fill;
      c.strokeStyle = edge;
      c.lineWidth = 3 * metre;
      c.stroke();
      c.fill();
      c.shadowBlur = 0;
      if (!target.cue) return;
      const [x, y] = target.front.map((part, axis) => (axis ? target.y : target.x) + part * 13 * metre);
      c.fillStyle = target.cue[0];
      c.beginPath();
      target.cue[1].forEach(([u, v]) => c.lineTo(x + 8 * metre * u, y + 8 * metre * v));
      c.fill();
    });
    room.props.forEach((prop, index) => {
      if (prop.kind === "plate") return;
      const poses = frames.props.length ? frames.props[at.i] : null;
      this.box_(c, poses ? { ...prop, x: poses[index][0], y: poses[index][1], yaw: poses[index][2] } : prop, look.prop, look.propEdge, metre);
    });
    this.robot(c, at, metre);
    this.label(c, metre);
  }

  outline(c, box) {
    c.save();
    c.translate(box.x, box.y);
    c.rotate(box.yaw);
    c.beginPath();
    if (box.shape === "cylinder") c.arc(0, 0, box.half_x, 0, 7);
    else c.rect(-box.half_x, -box.half_y, 2 * box.half_x, 2 * box.half_y);
    c.restore();
  }

  solid(c, solid, fill) { this.outline(c, solid); c.fillStyle = fill; c.fill(); }

  box_(c, box, fill, edge, metre) {
    this.outline(c, box);
    c.fillStyle = fill;
    c.fill();
    c.strokeStyle = edge;
    c.lineWidth = metre;
    c.stroke();
  }

  robot(c, at, metre) {
    const look = this.looks, radius = Math.max(this.room.radius, 3.5 * metre);
    const corners = this.room.corners;
    c.save();
    c.translate(at.x, at.y);
    c.rotate(at.heading);
    c.fillStyle = look.body;
    c.strokeStyle = look.bodyEdge;
    c.lineWidth = metre;
    c.beginPath();
    corners.forEach(([x, y], n) => n ? c.lineTo(x, y) : c.moveTo(x, y));
    if (corners.length) c.closePath();
    else c.arc(0, 0, radius, 0, 7);
    c.fill();
    c.stroke();
    c.fillStyle = "#fff";
    c.beginPath();
    c.moveTo(0.82 * radius, 0);
    c.lineTo(-0.6 * radius, 0.45 * radius);
    c.lineTo(-0.3 * radius, 0);
    c.lineTo(-0.6 * radius, -0.45 * radius);
    c.fill();
    c.restore();
    const arms = this.replay.frames.arm;
    if (!arms.length) return;
    const arm = arms[at.i].map(([x, y], n) => [x + at.t * (arms[at.j][n][0] - x), y + at.t * (arms[at.j][n][1] - y)]);
    c.strokeStyle = look.arm;
    c.lineWidth = 2.6 * metre;
    c.beginPath();
    for (const [x, y] of arm) c.lineTo(x, y);
    c.stroke();
    const hand = arm[arm.length - 1];
    c.fillStyle = look.hand;
    c.beginPath();
    c.arc(hand[0], hand[1], Math.max(this.room.hand, 2.5 * metre), 0, 7);
    c.fill();
  }

  label(c, metre) {
    const [ex, ey, ew, eh] = this.room.exit;
    c.save();
    c.translate(ex + ew / 2, ey + eh / 2);
    c.scale(metre, -metre);
    c.fillStyle = this.looks.exitInk;
    c.font = "600 11px system-ui, sans-serif";
    c.textAlign = "center";
    c.textBaseline = "middle";
    if (ew > 0 && eh > 0) c.fillText("exit", 0, 0); // a world without a puzzle has none
    c.restore();
    this.room.targets.forEach((target) => {
      c.save();
      c.translate(target.x + target.front[0] * (target.cue ? 28 : 13) * metre, target.y + target.front[1] * (target.cue ? 28 : 13) * metre);
      c.scale(metre, -metre);
      c.fillStyle = "#22262e";
      c.globalAlpha = 0.75;
      c.font = "600 10.5px system-ui, sans-serif";
      c.textAlign = "center";
      c.textBaseline = "middle";
      c.fillText(target.short, 0, 0);
      c.restore();
    });
  }
}
