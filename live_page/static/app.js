// The page of one run: asks for its plan, follows its stream of updates, and shows them.

import {kw, redrawCharts, timeChart} from "./chart.js";
import {plantMap} from "./map.js";
import {controlTree} from "./tree.js";
import {eventList, figures, timingStrip, values} from "./panels.js";

const $ = id => document.getElementById(id);
const WINDOWS = [["2 min", 120], ["10 min", 600], ["1 h", 3600], ["all", Infinity]];
const POWERS = [
  {label: "possible", color: "--possible", fill: "--possible-fill", width: 1},
  {label: "delivered", color: "--delivered", width: 2},
  {label: "desired", color: "--desired", dash: [7, 4], width: 2},
];
const NODE_POWERS = [
  {label: "possible", name: "mpp", color: "--possible", fill: "--possible-fill", width: 1},
  {label: "IMPP", name: "impp", color: "--impp"},
  {label: "request", name: "request", color: "--desired", dash: [7, 4]},
  {label: "setpoint", name: "setpoint", color: "--setpoint", dash: [3, 3], width: 2},
  {label: "delivered", name: "power", color: "--delivered", width: 2},
];
const LONGEST = 4000;  // Points of a chart before it is asked for anew, thinned out.

const json = async path => {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
};

// Theme ------------------------------------------------------------------------------------------

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  redrawCharts();
}
const system = matchMedia("(prefers-color-scheme: dark)");
setTheme(localStorage.theme ?? (system.matches ? "dark" : "light"));
system.addEventListener("change", () => localStorage.theme ?? setTheme(system.matches ? "dark" : "light"));
function toggleTheme() {
  localStorage.theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
  setTheme(localStorage.theme);
}

// The run ----------------------------------------------------------------------------------------

function showRun(plan) {
  const inverters = plan.nodes.filter(node => node.inverter).length;
  document.title = `${plan.plant} – Heliarch`;
  $("title").textContent = plan.plant;
  $("about").textContent = `${inverters} inverters, ${(plan.nodes[0].rating_kw / 1e3).toLocaleString("en", {maximumFractionDigits: 1})} MW, scheme ${plan.scheme}`;
  $("about").title = plan.run;
  $("back").hidden = !location.pathname.includes("/run/");

  const seconds = cycle => plan.start_ms / 1e3 + cycle * plan.cycle_s;
  const clock = new Intl.DateTimeFormat("en-GB", {timeZone: plan.timezone, hour: "2-digit", minute: "2-digit", second: "2-digit"});
  const day = new Intl.DateTimeFormat("en-GB", {timeZone: plan.timezone, year: "numeric", month: "short", day: "numeric"});
  const timeOf = cycle => clock.format(new Date(seconds(cycle) * 1e3));

  let live = true, playing = false, cycle = -1, cycles = 0, over = false, source = null;
  let span = WINDOWS[1][1], frame = null, selected = null;
  let power = {cycle: [], possible: [], desired: [], delivered: [], unavoidable: [], control_caused: []};
  let history = {cycle: []}, current = {};
  let devices = {};  // What the gateway measured of real inverters.
  let overviewCycles = -1, dragged = null;

  const seek = target => { live = false; playing = false; go(target); };
  const chart = (id, lines, height, cursorKey) => timeChart($(id), lines, {height, timezone: plan.timezone, cursorKey, onPick: at => seek((at - seconds(0)) / plan.cycle_s)});
  const powerChart = chart("power-chart", POWERS, 240, "plant");
  const shortfallChart = chart("shortfall-chart", [{label: "all", color: "--control", fill: "--control", width: 0}, {label: "unavoidable", color: "--unavoidable", fill: "--unavoidable", width: 0}], 100, "plant");
  const nodeChart = chart("node-chart", NODE_POWERS, 300, "node");
  const helpChart = chart("help-chart", [{label: "help", color: "--help", fill: "--help", width: 1}], 130, "node");
  const overview = timeChart($("overview"), POWERS, {height: 38, timezone: plan.timezone, bare: true});
  const map = plantMap($("map"), $("map-note"), plan, select);
  const tree = controlTree($("tree"), plan, select);
  const events = eventList($("events"), timeOf, seek);
  const timing = timingStrip($("timing"), $("timing-note"), plan);

  // The cycles shown: those up to the current one, as many as the window is long.
  const shown = () => {
    const length = Math.min(span / plan.cycle_s, span === Infinity ? cycles : Infinity, Math.max(plan.cycles, 2));
    const end = Math.max(cycle, Math.min(length, plan.cycles) - 1, 1);
    return {from: Math.max(end - length + 1, 0), to: end};
  };

  function drawPower() {
    const {from, to} = shown(), x = power.cycle.map(seconds);
    powerChart.show([x, ...POWERS.map(line => power[line.label])], seconds(from), seconds(to), seconds(cycle));
    const all = power.control_caused.map((value, row) => value === null ? null : value + power.unavoidable[row]);
    shortfallChart.show([x, all, power.unavoidable], seconds(from), seconds(to), seconds(cycle));
    values($("values"), [
      ...POWERS.map(line => ({...line, value: current[line.label]})),
      {label: "shortfall, unavoidable", value: current.unavoidable},
      {label: "shortfall, control-caused", value: current.control_caused},
    ]);
  }

  function drawNode() {
    const {from, to} = shown(), x = history.cycle.map(seconds);
    const column = name => history[name] ?? x.map(() => null);
    nodeChart.show([x, ...NODE_POWERS.map(line => column(line.name))], seconds(from), seconds(to), seconds(cycle));
    helpChart.show([x, column("help")], seconds(from), seconds(to), seconds(cycle));
    if (frame && selected !== null) values($("node-values"), [...NODE_POWERS, {label: "help", name: "help", color: "--help"}].map(line => ({...line, value: frame.nodes[line.name][selected]})));
  }

  // What came while older cycles were asked for stays behind them.
  function joined(loaded, newer) {
    const last = loaded.cycle.at(-1) ?? -1, kept = newer.cycle.map(value => value > last && value <= cycle);
    for (const name in newer) loaded[name] = (loaded[name] ?? []).concat(newer[name].filter((_, row) => kept[row]));
    return loaded;
  }

  async function load() {
    const {from, to} = shown(), part = `from=${Math.floor(from)}&to=${to}`, place = selected;
    power = joined(await json(`window?${part}&points=1500`), power);
    drawPower();
    if (place === null) return;
    const node = await json(`node?path=${encodeURIComponent(plan.nodes[place].path)}&${part}`);
    if (place !== selected) return;
    history = joined(node, history);
    drawNode();
  }
  // One at a time: the history of a node of a large plant takes the server a second.
  let loading = false, again = false;
  async function loadInTurn() {
    again = true;
    if (loading) return;
    loading = true;
    try {
      while (again) { again = false; await load(); }
    } finally { loading = false; }
  }
  let waiting = null;
  const reload = () => {
    clearTimeout(waiting);
    waiting = setTimeout(loadInTurn, 80);
  };

  async function redrawBar() {
    const last = Math.max(plan.cycles, cycles) - 1;
    $("position").max = last;
    const isOld = cycles - overviewCycles > last / 200 || (over && cycles !== overviewCycles);
    if (!isOld) return;
    overviewCycles = cycles;
    const whole = await json(`window?from=0&to=${cycles}&points=600`);
    overview.show([whole.cycle.map(seconds), ...POWERS.map(line => whole[line.label])], seconds(0), seconds(Math.max(last, 1)), null);
  }

  function select(place) {
    selected = place;
    $("node-title").textContent = plan.nodes[place].path || "central";
    describe();
    map.select(place);
    tree.select(place);
    history = {cycle: []};
    drawNode();
    reload();
  }

  function describe() {
    const node = plan.nodes[selected], {reads, late, breaks} = devices[node.path] ?? {};
    let text = `${node.inverter ? "inverter" : selected ? "supervisor" : "central controller"}, ${kw(node.rating_kw)} kW`;
    if (node.device) text += `; ${node.device} ${frame?.unread.includes(selected) ? "gives no readings" : "connected"}`;
    if (reads) text += `; reads take ${reads.p50_ms.toFixed(1)} ms (p50), ${reads.p99_ms.toFixed(1)} ms (p99), ${late} late, connection lost ${breaks}×`;
    $("node-about").textContent = text;
  }

  // Updates --------------------------------------------------------------------------------------

  function connect() {
    source?.close();
    source = new EventSource(live ? "stream" : `stream?from=${Math.max(cycle, 0)}&speed=${playing ? $("speed").value : 0}`);
    let fresh = true;
    source.onopen = () => { $("banner").hidden = true; fresh = true; };
    source.onerror = () => {
      $("banner").textContent = over
        ? "The run is over and the page is no longer served. What is shown stays; `heliarch view` opens the recording."
        : "Connection lost: the page shows what came last and tries again.";
      $("banner").hidden = false;
    };
    source.onmessage = message => {
      update(JSON.parse(message.data), fresh);
      fresh = false;
    };
    showControls();
  }

  function update(news, fresh) {
    cycles = news.cycles ?? 0;
    over = ["over", "failed"].includes(news.state);
    const state = news.reading != null ? `reading ${Math.round(100 * news.reading)} %` : {waiting: "starting", silent: "nothing new", over: "over", failed: "failed", running: "running"}[news.state];
    $("state").textContent = live || over ? state : `${state}, ${playing ? "playing" : "paused"}`;
    $("state").className = `badge ${news.state}`;
    if (news.events?.length) events.add(news.events);
    if (news.figures) {
      figures($("figures"), news.figures);
      $("figures-about").textContent = `${cycles.toLocaleString("en")} cycles so far`;
    }
    devices = news.devices ?? devices;
    if (news.frame) showFrame(news, fresh);
    if (!live && playing && cycle >= cycles - 1) { playing = false; connect(); }
    redrawBar();
  }

  function showFrame(news, fresh) {
    frame = news.frame;
    const before = cycle;
    cycle = frame.cycle;
    const columns = news.plant;
    for (const name in columns) current[name] = columns[name].at(-1);
    const follows = !fresh && before < cycle && columns.cycle[0] > (power.cycle.at(-1) ?? -1);
    if (follows && power.cycle.length + columns.cycle.length < LONGEST) {
      const first = shown().from, drop = power.cycle.findIndex(value => value >= first);
      for (const name in power) power[name] = power[name].slice(Math.max(drop, 0)).concat(columns[name]);
      drawPower();
      if (selected !== null) {
        history.cycle.push(cycle);
        for (const name in frame.nodes) (history[name] ??= []).push(frame.nodes[name][selected]);
        while (history.cycle[0] < first) for (const name in history) history[name].shift();
        drawNode();
      }
    } else reload();
    const more = map.show(frame);
    if (plan.positions_m.length) $("map-note").textContent = more > 0 ? `${more} smaller helps are not drawn.` : "";
    tree.show(frame);
    timing(frame.timing);
    events.dim(cycle);
    $("clock").textContent = timeOf(cycle);
    $("clock").title = day.format(new Date(seconds(cycle) * 1e3));
    if (dragged === null) $("position").value = cycle;
    $("position-text").textContent = `cycle ${(cycle + 1).toLocaleString("en")} of ${Math.max(plan.cycles, cycles).toLocaleString("en")}`;
    if (selected === null) select(plan.nodes.findIndex(node => node.inverter));
    describe();
  }

  // Controls -------------------------------------------------------------------------------------

  function showControls() {
    $("play").textContent = playing ? "❚❚" : "▶";
    $("live").setAttribute("aria-pressed", live);
  }
  function go(target) {
    live = false;
    cycle = Math.round(Math.min(Math.max(target, 0), Math.max(cycles - 1, 0)));
    connect();
  }
  const step = by => { playing = false; go(cycle + by); };
  function play() {
    playing = live ? false : !playing;
    if (playing && cycle >= cycles - 1) cycle = 0;
    live = false;
    connect();
  }
  function newest() { live = true; playing = false; connect(); }
  $("position").addEventListener("input", event => {
    const target = +event.target.value;
    clearTimeout(dragged);
    dragged = setTimeout(() => { dragged = null; seek(target); }, 60);
  });
  $("play").onclick = play;
  $("step").onclick = () => step(1);
  $("back-step").onclick = () => step(-1);
  $("live").onclick = newest;
  $("speed").onchange = () => playing && connect();
  $("theme").onclick = toggleTheme;
  const buttons = WINDOWS.map(([name, length]) => {
    const button = Object.assign(document.createElement("button"), {textContent: name});
    button.onclick = () => {
      span = length;
      buttons.forEach(other => other.setAttribute("aria-pressed", other === button));
      reload();
    };
    button.setAttribute("aria-pressed", length === span);
    return button;
  });
  $("windows").append(...buttons);
  const neighbour = by => select(tree.order[(tree.order.indexOf(selected) + by + tree.order.length) % tree.order.length]);
  const keys = {
    " ": play, ArrowRight: event => step(event.shiftKey ? 10 : 1), ArrowLeft: event => step(event.shiftKey ? -10 : -1),
    Home: () => step(-Infinity), End: newest, l: newest, t: toggleTheme,
    n: () => neighbour(1), p: () => neighbour(-1),
  };
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT" || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key](event);
  });
  connect();
}

// A page may be open before the run has begun.
async function begin() {
  for (;;) {
    try {
      const plan = await json("plan");
      if (plan) return showRun(plan);
      $("state").textContent = "starting";
    } catch (error) {
      $("banner").textContent = error.message;
      $("banner").hidden = false;
    }
    await new Promise(resolve => setTimeout(resolve, 500));
  }
}
begin();
