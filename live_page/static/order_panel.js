// What the plant is asked for and by whom; on a page that may give orders, a form for them.

import {$} from "./dom.js";
import {power} from "./chart.js";

const inWords = value => power(value).join(" ");

/** @returns {number | null} */
function number(id) {
  const text = $(id).value.trim();
  return text === "" ? null : Number(text);
}

let following = new AbortController();  // The newest order; the answer to an older one is not shown.

// The first line of an answer says what became of the order, each later one how far the plant is.
async function give(order) {
  following.abort();
  following = new AbortController();
  const {signal} = following, answer = $("order-answer"), settling = $("order-settling");
  answer.textContent = "sent: it counts from the next cycle on";
  settling.textContent = "";
  let text = "";
  try {
    const request = {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(order), signal};
    const reply = await fetch("order", request);
    answer.classList.toggle("bad", !reply.ok);
    const parts = reply.body.pipeThrough(new TextDecoderStream()).getReader();
    for (let part = await parts.read(); !part.done; part = await parts.read()) {
      text += part.value;
      const lines = text.split("\n").slice(0, -1);
      if (lines.length) answer.textContent = lines[0];
      if (lines.length > 1) settling.textContent = lines.at(-1);
    }
  } catch (error) {
    if (!signal.aborted) answer.textContent = error.message;
  }
}

function takeOrders() {
  const slider = $("order-slider"), typed = $("order-power"), ramp = $("order-ramp");
  slider.oninput = () => { typed.value = slider.value; };
  typed.oninput = () => { slider.value = typed.value; };
  $("order-form").onsubmit = event => {
    event.preventDefault();
    give({power_kw: number("order-power"), ramp_kw_per_min: number("order-ramp"), hold_s: number("order-hold")});
  };
  $("order-schedule").onclick = () => ramp.reportValidity() && give({power_kw: null, ramp_kw_per_min: number("order-ramp")});
}

function textOf({source, text, since, until, power_kw, target_kw}, time) {
  const parts = [source ? `${source}: ${text}` : text];
  if (since !== null) parts.push(`since ${time.timeOf(since)}`);
  if (until !== null) parts.push(`until ${time.timeOf(until)}`);
  parts.push(power_kw === target_kw ? inWords(power_kw) : `on a ramp: ${inWords(power_kw)} of ${inWords(target_kw)}`);
  return parts.join(", ");
}

export function orderPanel(plan, time) {
  const rating = plan.nodes[0].rating_kw, step = 10 ** Math.floor(Math.log10(rating / 200));
  for (const id of ["order-form", "order-limits"]) $(id).hidden = !plan.takes_orders;
  for (const id of ["order-slider", "order-power"]) $(id).max = String(rating);
  $("order-slider").step = String(step);
  if (plan.takes_orders) takeOrders();
  let isFilled = false;
  return {
    show({order, nodes}) {
      $("orders").hidden = !order || !(plan.takes_orders || order.source);
      if (!order) return;
      $("order-now").textContent = `Present order: ${textOf(order, time)}`;
      $("order-limits").textContent = `Least 0, most ${inWords(rating)}; available now ${inWords(nodes.mpp[0])}. Ramp empty: at once. Hold empty: until the next order.`;
      if (isFilled) return;
      isFilled = true;
      $("order-slider").value = $("order-power").value = String(Math.round(order.power_kw / step) * step);
    },
  };
}
