// Orders to the plant, on a page that may give them.

import {$} from "./dom.js";

function number(id) {
  const text = $(id).value.trim();
  return text === "" ? null : Number(text);
}

async function give(order) {
  const form = $("order-form"), answer = $("order-answer");
  for (const button of form.querySelectorAll("button")) button.disabled = true;
  answer.textContent = "ordered; waiting until the plant has settled";
  try {
    const body = JSON.stringify(order);
    const reply = await fetch("order", {method: "POST", headers: {"Content-Type": "application/json"}, body});
    answer.textContent = await reply.text();
  } catch (error) {
    answer.textContent = error.message;
  }
  for (const button of form.querySelectorAll("button")) button.disabled = false;
}

export function showOrders() {
  $("orders").hidden = false;
  $("order-form").onsubmit = event => {
    event.preventDefault();
    give({power_kw: number("order-power"), ramp_kw_per_min: number("order-ramp")});
  };
  $("order-schedule").onclick = () => give({power_kw: null, ramp_kw_per_min: number("order-ramp")});
}
