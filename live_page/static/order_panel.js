// Orders to the plant, on a page that may give them.

import {$} from "./dom.js";

let following = new AbortController();  // The newest order; the answer to an older one is not shown.

function number(id) {
  const text = $(id).value.trim();
  return text === "" ? null : Number(text);
}

async function give(order) {
  following.abort();
  following = new AbortController();
  const {signal} = following, answer = $("order-answer");
  answer.textContent = "ordered";
  try {
    const request = {method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify(order), signal};
    const reply = await fetch("order", request);
    const lines = reply.body.pipeThrough(new TextDecoderStream()).getReader();
    answer.textContent = "";
    for (let part = await lines.read(); !part.done; part = await lines.read()) answer.textContent += part.value;
  } catch (error) {
    if (!signal.aborted) answer.textContent += ` ${error.message}`;
  }
}

export function showOrders() {
  $("orders").hidden = false;
  $("order-form").onsubmit = event => {
    event.preventDefault();
    give({power_kw: number("order-power"), ramp_kw_per_min: number("order-ramp")});
  };
  $("order-schedule").onclick = () => give({power_kw: null, ramp_kw_per_min: number("order-ramp")});
}
