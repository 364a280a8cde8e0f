// The page of one run: asks for its plan, follows its stream of updates, and hands them to the panels.

import {chartGroup} from "./chart.js";
import {cloudLayer} from "./clouds.js";
import {$, json} from "./dom.js";
import {eventList} from "./events.js";
import {plantMap} from "./map.js";
import {orderPanel} from "./order_panel.js";
import {keepInAddress, placeInAddress} from "./links.js";
import {nodePanel} from "./node_panel.js";
import {figures} from "./panels.js";
import {playback} from "./playback.js";
import {positionBar} from "./position_bar.js";
import {powerPanel} from "./power_panel.js";
import {runTime, timeSpan} from "./run_time.js";
import {sentence} from "./sentence.js";
import {controlTree} from "./tree.js";

function showHeader(plan) {
  const inverters = plan.nodes.filter(node => node.inverter).length;
  document.title = `${plan.plant} – Heliarch`;
  $("title").textContent = plan.plant;
  $("about").textContent = `${inverters} inverters, ${(plan.nodes[0].rating_kw / 1e3).toLocaleString("en", {maximumFractionDigits: 1})} MW, scheme ${plan.scheme}`;
  $("about").title = plan.run;
  $("back").hidden = !location.pathname.includes("/run/");
}

// Calls a function some time after it was asked for, and one call at a time: the history of a node of a
// large plant takes the server a second.
function inTurn(act) {
  let busy = false, again = false, waiting = null;
  async function run() {
    again = true;
    if (busy) return;
    busy = true;
    try {
      while (again) { again = false; await act(); }
    } finally { busy = false; }
  }
  return () => {
    clearTimeout(waiting);
    waiting = setTimeout(run, 80);
  };
}

function showRun(plan) {
  showHeader(plan);
  const time = runTime(plan), place = placeInAddress(), orders = orderPanel(plan, time);
  let chosen = place.cycle;
  const {at, connect, seek, keys} = playback(update, place.cycle, cycle => { chosen = cycle; keep(); });
  const reload = inTurn(async () => {
    const {from, to} = span.shown(at), part = `from=${Math.floor(from)}&to=${Math.ceil(to)}`;
    await power.load(part);
    await node.load(part);
  });
  const span = timeSpan($("windows"), plan, () => { reload(); keep(); }, place.span);
  function keep() {
    if (node?.selected != null) keepInAddress({cycle: chosen, node: plan.nodes[node.selected].path, span: span.zoomed()});
  }
  const group = chartGroup({
    timezone: plan.timezone,
    onPick: x => seek(time.cycleAt(x)),
    onZoom: to => span.zoomTo(to && {from: Math.max(time.cycleAt(to.from), 0), to: time.cycleAt(to.to)}),
  });
  const power = powerPanel(time, group, span.shown, at);
  const node = nodePanel(plan, time, group, span.shown, at);
  const bar = positionBar(plan, time, at, seek);
  let map = plantMap($("map"), $("map-note"), $("clusters"), plan, select), latest = null;
  $("plants").hidden = plan.plants.length < 2;
  $("plants").append(...plan.plants.map(name => new Option(name)));
  $("plants").onchange = () => {
    map = plantMap($("map"), $("map-note"), $("clusters"), plan, select, $("plants").value);
    if (latest) map.show(latest);
  };
  const showClouds = plan.has_clouds ? cloudLayer($("map"), map.place) : () => {};
  const tree = controlTree($("tree"), plan, select);
  const events = eventList($("events"), $("later"), time.timeOf, seek);
  let devices = {};

  function select(number) {
    node.select(number);
    map.select(number);
    tree.select(number);
    reload();
    keep();
  }

  function update(news, fresh) {
    if (news.events) events.replace(news.events);
    if (news.figures) figures($("figures"), $("figures-about"), news.figures);
    devices = news.devices ?? devices;
    if (news.frame) showFrame(news, fresh);
    bar.drawOverview();
  }

  function showFrame({frame, plant}, fresh) {
    const goesOn = !fresh && at.cycle < frame.cycle;
    at.cycle = frame.cycle;
    events.showAt(at.cycle);
    group.marks = events.marks().map(mark => ({...mark, seconds: time.seconds(mark.cycle)}));
    power.note(plant);
    node.show(frame, devices);
    if (goesOn && power.follows(plant)) {
      power.append(plant);
      node.append();
    } else reload();
    latest = frame;
    const more = map.show(frame);
    if (plan.positions_m.length) $("map-note").textContent = more > 0 ? `${more} smaller helps are not drawn.` : "";
    tree.show(frame);
    orders.show(frame);
    showClouds(at.cycle);
    $("sentence").textContent = `${time.timeOf(at.cycle)}: ${sentence(plan, frame)}`;
    $("clock").textContent = time.timeOf(at.cycle);
    $("day").textContent = time.dayOf(at.cycle);
    bar.show();
    if (node.selected === null) {
      const named = plan.nodes.findIndex(each => place.node && each.path === place.node);
      select(named >= 0 ? named : plan.nodes.findIndex(each => each.inverter));
    }
  }

  const neighbour = by => select(tree.order[(tree.order.indexOf(node.selected) + by + tree.order.length) % tree.order.length]);
  const help = () => $("keys").open ? $("keys").close() : $("keys").showModal();
  Object.assign(keys, {n: () => neighbour(1), p: () => neighbour(-1), "?": help});
  $("help").onclick = help;
  document.addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target instanceof HTMLSelectElement || !keys[event.key]) return;
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
