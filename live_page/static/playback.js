// Where the page stands: at the newest cycle, or at one that the user chose, still or playing.

import {$} from "./dom.js";

const RETRY_MS = 2000;
const STATES = {waiting: "starting", stalled: "nothing new"};

// `onUpdate` gets each update of the server, and whether it is the first one of its stream.
// `at`: the cycle shown, how many cycles there are, and whether the run is over.
// `first`: the cycle to begin with; null: the newest one. `onSeek` gets the cycle that the user chose, or null.
export function playback(onUpdate, first, onSeek) {
  const at = {cycle: first ?? -1, cycles: 0, over: false};
  let live = first === null, playing = false, source = null, again = null;

  function connect() {
    source?.close();
    clearTimeout(again);
    source = new EventSource(live ? "stream" : `stream?from=${Math.max(at.cycle, 0)}&speed=${playing ? $("speed").value : 0}`);
    let fresh = true;
    source.onopen = () => { $("banner").hidden = true; fresh = true; };
    source.onerror = () => {
      $("banner").textContent = at.over
        ? "The run is over and the page is no longer served. What is shown stays; `heliarch view` opens the recording."
        : "Connection lost: the page shows what came last and tries again.";
      $("banner").hidden = false;
      // The browser would ask for the first cycle again, and after a refusal for nothing.
      source.close();
      again = setTimeout(connect, RETRY_MS);
    };
    source.onmessage = message => {
      const news = JSON.parse(message.data);
      showState(news);
      onUpdate(news, fresh);
      fresh = false;
      if (!live && playing && at.cycle >= at.cycles - 1) { playing = false; live = !at.over; connect(); }
    };
    $("live").setAttribute("aria-pressed", String(live));
    $("speed").hidden = live && !at.over;  // What is followed goes at the run's own pace.
    onSeek(live ? null : at.cycle);
  }

  function showState(news) {
    at.cycles = news.cycles ?? 0;
    at.over = !["waiting", "running", "stalled"].includes(news.state);
    const state = news.reading != null ? `reading ${Math.round(100 * news.reading)} %` : STATES[news.state] ?? news.state;
    $("state").textContent = live || at.over ? state : `${state}, ${playing ? "playing" : "paused"}`;
    $("play").textContent = playing || (live && !at.over) ? "❚❚" : "▶";
    $("state").className = `badge ${news.state}`;
  }

  function seek(target) {
    live = playing = false;
    const last = at.cycles ? at.cycles - 1 : target;
    at.cycle = Math.round(Math.min(Math.max(target, 0), last));
    connect();
  }
  const step = by => seek(at.cycle + by);
  function play() {
    const ended = at.over && at.cycle >= at.cycles - 1;
    playing = ended || (!live && !playing);
    if (ended) at.cycle = 0;
    live = false;
    connect();
  }
  function newest() { live = true; playing = false; connect(); }

  $("play").onclick = play;
  $("step").onclick = () => step(1);
  $("back-step").onclick = () => step(-1);
  $("live").onclick = newest;
  $("speed").onchange = () => playing && connect();
  return {
    at, connect, seek,
    keys: {
      " ": play, ArrowRight: event => step(event.shiftKey ? 10 : 1), ArrowLeft: event => step(event.shiftKey ? -10 : -1),
      Home: () => step(-Infinity), End: newest, l: newest,
    },
  };
}
