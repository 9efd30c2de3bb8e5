// The live page: status once a second, events as they are committed. Everything that grows has an end.
"use strict";
(function () {
  const MOST_ENVELOPES = 24, MOST_EVENTS = 60, MOST_CAMERAS = 8, SILENT_S = 5;
  const at = (id) => document.getElementById(id);
  const show = spaceView(at("space")), envelopes = [];
  let heard = Date.now(), journal = null, cameras = [];
  const text = (value) => (value === null || value === undefined ? "–" : String(value));
  function cells(row, values) {
    values.forEach((value, k) => {
      const cell = row.insertCell();
      cell.textContent = value;
      if (k === values.length - 1) cell.className = "flags";
    });
  }
  function fill(id, rows) {
    const body = document.createElement("tbody");
    rows.forEach((values) => cells(body.insertRow(), values));
    at(id).tBodies[0].replaceWith(body);
  }
  function envelope(shown) {
    fill("targets", shown.rows);
    document.body.dataset.seq = shown.seq;
    if (!shown.space) return;
    envelopes.push(shown.space);
    while (envelopes.length > MOST_ENVELOPES) envelopes.shift();
    at("none").hidden = true;
    show(envelopes, envelopes.length - 1);
  }
  // One request at a time for each camera: what comes meanwhile is asked for afterwards, and only the last of it.
  function frames(seq) {
    cameras.forEach((camera) => {
      const image = camera.image;
      camera.wanted = seq;
      if (camera.asked) return;
      const next = () => {
        camera.asked = camera.wanted;
        image.src = "/live/frame/" + encodeURIComponent(camera.name) + ".jpg?seq=" + camera.asked;
      };
      const done = (worked) => {
        camera.box.hidden = !worked && !camera.shown;
        camera.shown = camera.shown || worked;
        const again = camera.wanted !== camera.asked;
        camera.asked = null;
        if (again) next();
      };
      image.onload = () => done(true);
      image.onerror = () => done(false);
      next();
    });
  }
  function capture(shown) {
    fill("gauges", shown.gauges);
    if (cameras.map((one) => one.name).join() === shown.cameras.join()) return;
    cameras = shown.cameras.slice(0, MOST_CAMERAS).map((name) => {
      const box = document.createElement("figure"), image = document.createElement("img"), about = document.createElement("figcaption");
      image.alt = about.textContent = name + ": the last frame, with the vectors as soon as they are measured";
      box.hidden = true;
      box.append(image, about);
      return { name: name, image: image, box: box, asked: null, wanted: null, shown: false };
    });
    at("frames").replaceChildren(...cameras.map((one) => one.box));
  }
  function take(shown) {
    if (shown.kind === "envelope") envelope(shown);
    if (shown.kind === "capture.completed") capture(shown);
    if (shown.kind === "envelope" || shown.kind === "capture.completed") frames(shown.seq);
  }
  function line(shown) {
    const body = at("events").tBodies[0], row = body.insertRow(0);
    cells(row, [new Date(shown.at).toLocaleTimeString(), shown.kind, shown.about]);
    row.lastChild.className = shown.kind === "fault" ? "flags" : "";
    while (body.rows.length > MOST_EVENTS) body.deleteRow(-1);
  }
  function listen(after) {
    const source = new EventSource(after === null ? "/live/events" : "/live/events?after=" + after);
    source.addEventListener("journal", (message) => {
      const about = JSON.parse(message.data);
      if (journal !== null && journal !== about.journal) location.reload(); // another history
      journal = about.journal;
    });
    source.onmessage = (message) => {
      const shown = JSON.parse(message.data);
      line(shown);
      take(shown);
      if (shown.kind.startsWith("campaign.")) queue();
    };
  }
  function say(problem) {
    at("alarm").hidden = !problem;
    at("alarm").textContent = problem || "";
  }
  function status(s) {
    at("title").textContent = s.name ? s.name + " – " + s.state : "labdaemon – " + s.state;
    document.title = (s.state === "running" ? "▶ " : "") + at("title").textContent;
    at("place").textContent = [s.rig, s.data, s.host].filter(Boolean).join(" · ");
    const left = s.left_s === null || s.left_s === undefined ? null : Math.round(s.left_s / 60) + " min left";
    const facts = [[text(s.table), "table"], [text(s.doing), left || "doing"],
      [s.step === null || s.step === undefined ? "–" : s.step + 1 + " of " + s.steps, "step " + (s.label || "")],
      [s.frequency_hz ? s.frequency_hz + " Hz" : "–", s.amplitude_mm ? s.amplitude_mm + " mm" : "excitation"],
      [s.captures === null || s.captures === undefined ? "–" : s.captures + " of " + s.captures_total, "captures"],
      [s.largest_mm ? s.largest_mm.toFixed(3) + " mm" : "–", "largest, " + text(s.largest_target)], [text(s.faults), "faults"]];
    at("numbers").replaceChildren(...facts.map(([value, label]) => {
      const box = document.createElement("div"), strong = document.createElement("b"), span = document.createElement("span");
      strong.textContent = value;
      span.textContent = label;
      box.append(strong, span);
      return box;
    }));
    at("progress").hidden = !s.captures_total;
    at("progress").max = s.captures_total || 1;
    at("progress").value = s.captures || 0;
    const fault = s.last_fault && s.state !== "running" ? "Last fault: " + (s.last_fault.message || JSON.stringify(s.last_fault)) : "";
    say(s.table === "unconfirmed" ? "The table is not seen at rest. Use the emergency stop." : fault);
  }
  async function ask(path) {
    const answer = await fetch(path, { cache: "no-store" });
    if (!answer.ok) throw new Error(path + " answers " + answer.status);
    return answer.json();
  }
  async function queue() {
    try {
      const found = (await ask("/campaigns")).result;
      fill("queue", (found.campaigns || []).map((one) => [text(one.id), text(one.name), one.state + (one.reason ? ": " + one.reason : "")]));
    } catch (problem) { // the next event of a campaign asks again
      fill("queue", []);
    }
  }
  async function beat() {
    try {
      status((await ask("/status")).result);
      heard = Date.now();
    } catch (problem) {
      if (Date.now() - heard > SILENT_S * 1000) say("The daemon is silent. What is shown is old.");
    }
    setTimeout(beat, 1000);
  }
  async function start() {
    let after = null;
    try { // the last of each kind first, so that the page is never empty on a running rig
      const last = await ask("/live/latest");
      after = last.last;
      last.events.forEach(take);
    } catch (problem) { // nothing yet: events will come
      at("none").hidden = false;
    }
    queue();
    listen(after);
    beat();
  }
  start();
})();
