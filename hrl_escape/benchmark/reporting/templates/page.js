"use strict";
// Joins the page's data with its charts and players.

const data = JSON.parse(document.getElementById("data").textContent);
const hidden = new Set();
const isDark = matchMedia("screen and (prefers-color-scheme: dark)").matches; // names are darker than their lines on white alone

function pick(role, then) {
  const group = document.querySelector(`[data-role="${role}"]`);
  if (group.tagName === "SELECT") {
    group.addEventListener("change", then);
    return () => group.value;
  }
  group.addEventListener("click", (event) => {
    if (event.target.tagName !== "BUTTON") return;
    for (const button of group.children) button.setAttribute("aria-pressed", button === event.target);
    then();
  });
  return () => group.querySelector('[aria-pressed="true"]').dataset.value;
}

// --- learning curves ---------------------------------------------------------------------

const measure = (box) => Math.max(300, box.clientWidth - 10); // a chart's unit is a pixel, so that words stay legible
const percent = (v) => `${Number((100 * v).toPrecision(3))} %`;
const METRICS = {
  return: { title: "return", source: "return", isFree: true, interval: "t", note: "Undiscounted return of an evaluation episode." },
  efficiency: { title: "efficiency", source: "efficiency", note: "Efficiency is 0 without escape, else the fewest primitives known over those taken." },
  progress: { title: "progress", source: "progress", yRange: [0, 1], note: "Share of the facts on the way to the goal that hold at best in an episode." },
  score: { title: "return score", source: "score", note: "A return score of 1 is the best known return, 0 is never escaping." },
  gap: { title: "gap to the best known", source: "efficiency", yLog: true, yReverse: true, turn: (v) => Math.max(5e-4, 1 - v),
    yRange: [5e-4, 1], format: (v) => (v < 6e-4 ? "< 0.0006" : formatNumber(v)),
    note: "What is missing to an efficiency of 1, on a logarithmic scale: higher is closer to the best known escape." },
  success: { title: data.has_rooms ? "episodes that escape" : "episodes that succeed", source: "success", yRange: [0, 1], format: percent,
    note: `Share of evaluation episodes that end in ${data.has_rooms ? "an escape" : "success"}.` },
  length: { title: "primitives an episode", source: "length", yLog: true, yReverse: true,
    note: "Primitives an evaluation episode takes, successful or not, on a logarithmic scale: higher is shorter." },
};
const AXES = { primitives: "primitives of training", decisions: "decisions of training", seconds: "seconds of training" };
const getMetric = pick("metric", drawCurves), getAgainst = pick("against", drawCurves), getRoom = pick("room", drawCurves);

function drawCurves() {
  const metric = METRICS[getMetric()], against = getAgainst(), room = Number(getRoom());
  const turn = metric.turn || ((v) => v);
  const series = data.agents.filter((agent) => !hidden.has(agent.label)).flatMap((agent) => {
    const curve = room < 0 ? agent.curve : agent.room_curves[room];
    if (!curve) return [];
    const [y, low, high] = curve[metric.source].map((values) => values.map(turn));
    return [{ name: agent.title, colour: agent.colour, text: isDark ? agent.colour : agent.text, dash: agent.dash, thin: agent.is_level, x: curve[against], y, low, high }];
  });
  const all = series.flatMap((s) => (s.thin ? s.y : [...s.low, ...s.high]));
  const range = metric.yRange || (metric.yLog ? [Math.max(1, Math.min(...all)) * 0.85, Math.max(...all) * 1.15]
    : metric.isFree ? [Math.min(...all), Math.max(...all) + 1e-9] : [Math.min(0, ...all), Math.max(1, ...all)]);
  const box = document.getElementById("curve-chart"), width = measure(box);
  drawChart(box, series, {
    width, height: Math.max(width > 620 ? 400 : 300, width > 620 ? 70 + 17 * series.length : 0), xTitle: AXES[against], xUnit: against, yTitle: metric.title, yLog: metric.yLog,
    yReverse: metric.yReverse, yRange: range, names: true, yFormat: metric.format,
    tipFormat: metric.format || ((v) => (["efficiency", "progress", "score"].includes(metric.source) ? v.toFixed(3) : formatNumber(v))),
    xFormat: (v) => (v >= 1000 ? Math.round(v).toLocaleString("en") : formatNumber(v)),
  });
  const axis = against === "primitives" ? "" : ` An agent's line ends where its budget of primitives was spent: after ${against === "decisions"
    ? "as many decisions as that took; an option is one decision of many primitives." : "so much training, evaluations left out."}`;
  document.getElementById("curve-note").textContent = `${metric.note} Lines are interquartile means over runs${
    ["progress", "success", "return"].includes(metric.source) ? " (here means)" : ""}, bands 95 % ${metric.interval || ""} intervals; dashes act without options; thin lines without a band are agents without training.${axis}`;
}

const legend = document.querySelector(".legend");
for (const agent of data.agents) {
  const button = document.createElement("button"), name = document.createElement("span");
  name.className = "agent" + (agent.dash ? " flat" : "");
  name.style.setProperty("--line", agent.colour);
  name.textContent = agent.title;
  name.title = agent.label;
  button.append(name);
  button.setAttribute("aria-pressed", true);
  button.title = "Show or hide";
  button.addEventListener("click", () => {
    hidden.has(agent.label) ? hidden.delete(agent.label) : hidden.add(agent.label);
    button.setAttribute("aria-pressed", !hidden.has(agent.label));
    drawCurves();
    drawProfile();
  });
  legend.append(button);
}

// --- performance profile -------------------------------------------------------------------

const getProfile = pick("profile", drawProfile);

function drawProfile() {
  const close = getProfile() === "close";
  const kept = data.thresholds.map((_, i) => i).filter((i) => (close ? data.thresholds[i] <= 0.9991 : true));
  const x = kept.map((i) => (close ? 1 - data.thresholds[i] : data.thresholds[i]));
  const series = data.agents.filter((agent) => !hidden.has(agent.label)).map((agent) => {
    const y = kept.map((i) => agent.profile[i]);
    const order = close ? [...kept.keys()].reverse() : [...kept.keys()];
    const ys = order.map((i) => y[i]);
    return { name: agent.title, colour: agent.colour, text: isDark ? agent.colour : agent.text, dash: agent.dash, thin: agent.is_level, x: order.map((i) => x[i]), y: ys, low: ys, high: ys };
  });
  const box = document.getElementById("profile-chart");
  drawChart(box, series, {
    width: measure(box), height: 330, step: true, yRange: [0, 1.02], yTitle: "share of runs above", yFormat: percent,
    xTitle: close ? "efficiency (logarithmic towards 1)" : data.measure, xUnit: "", xLog: close, xReverse: close,
    xRange: close ? [9e-4, 1] : data.has_rooms ? [Math.min(0, data.thresholds[0]), 1] : [data.thresholds[0], data.thresholds.at(-1)], tipFormat: percent,
    xFormat: (v) => (close ? String(Number((1 - v).toPrecision(4))) : formatNumber(v)),
  });
}

// --- replays -------------------------------------------------------------------------------

const players = [];
const [getKind, getReplayRoom] = data.has_rooms ? [pick("replay-kind", showCards), pick("replay-room", showCards)] : [];
const playAll = document.getElementById("play-all"); // only in rooms

function makePlayer(box, number, compact) {
  const replay = data.replays[number];
  return new Player(box, data.rooms[replay.room], replay, data.looks, compact);
}

function describeReplay(replay) {
  const end = replay.success ? `escapes after ${replay.primitives.toLocaleString("en")} primitives` : `no escape in ${replay.primitives.toLocaleString("en")} primitives`;
  return [`${end}, return ${formatNumber(replay.return)}`, `training seed ${replay.seed}, evaluation episode ${replay.episode + 1}`];
}

function showCards() {
  const cards = document.getElementById("cards"), room = Number(getReplayRoom()), kind = getKind();
  players.splice(0).forEach((player) => player.pause());
  cards.replaceChildren();
  data.agents.forEach((agent) => {
    const number = data.replays.findIndex((r) => r.agent === agent.label && r.room === room && r.kinds.includes(kind));
    if (number < 0) return;
    const card = document.createElement("article"), head = document.createElement("h3"), name = document.createElement("span");
    card.className = "card";
    name.className = "agent" + (agent.dash ? " flat" : "");
    name.style.setProperty("--line", agent.colour);
    name.textContent = agent.title;
  name.title = agent.label;
    head.append(name);
    const what = document.createElement("div"), box = document.createElement("div");
    what.className = "what";
    for (const line of describeReplay(data.replays[number])) {
      const part = document.createElement("span");
      part.textContent = line;
      what.append(part);
    }
    box.className = "player";
    card.append(head, what, box);
    cards.append(card);
    players.push(makePlayer(box, number, false));
  });
}

playAll?.addEventListener("click", () => {
  const start = !players.some((player) => player.playing);
  for (const player of players) {
    if (start) { player.time = 0; player.play(); } else player.pause();
  }
});

for (const box of document.querySelectorAll("[data-replay]")) {
  if (box.dataset.replay === "") continue;
  const player = makePlayer(box, Number(box.dataset.replay), "compact" in box.dataset);
  player.loops = true;
  if (STILL) player.show(player.count);
  else player.play();
}
drawCurves();
drawProfile();
if (data.has_rooms) showCards();
let drawnAt = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === drawnAt) return;
  drawnAt = window.innerWidth;
  drawCurves();
  drawProfile();
});
