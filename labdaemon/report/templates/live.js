// The live page: status once a second, events as they are committed. Everything that grows has an end.
"use strict";
(function () {
  const MOST_ENVELOPES = 24, MOST_EVENTS = 60, SILENT_S = 5;
  const at = (id) => document.getElementById(id);
  const show = spaceView(at("space")), envelopes = [], signed = [];
  let heard = Date.now(), journal = null;
  const text = (value) => (value === null || value === undefined ? "–" : String(value));
  const number = (value, digits) => (typeof value === "number" ? value.toFixed(digits) : "–");
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
  const dot = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  function axes(t) { // semi-major axis of the orbit, mm
    const a = [t.ax_mm || 0, t.ay_mm || 0, t.az_mm || 0], b = [t.bx_mm || 0, t.by_mm || 0, t.bz_mm || 0];
    const sum = (dot(a, a) + dot(b, b)) / 2, difference = (dot(a, a) - dot(b, b)) / 2;
    return Math.sqrt(sum + Math.hypot(difference, dot(a, b)));
  }
  const doubtful = (flags) => flags.some((flag) => flag !== "at_rest" && flag !== "contradicts_group");
  function envelope(event) {
    const data = event.data, seen = data.targets.filter((t) => t.ax_mm !== null && t.ax_mm !== undefined && t.x_mm !== null);
    const names = ["x", "y", "z", "ax", "ay", "az", "bx", "by", "bz"];
    const targets = seen.map((t) => [t.target, ...names.map((n) => t[n + "_mm"] || 0), axes(t), doubtful(t.flags || []) ? 1 : 0]);
    fill("targets", data.targets.map((t) => [
      t.target, t.ax_mm === null || t.ax_mm === undefined ? "–" : number(axes(t), 4),
      number(Math.max(t.sd_ax_mm || 0, t.sd_ay_mm || 0, t.sd_az_mm || 0), 4), (t.flags || []).join(", ")]));
    if (!targets.length) return;
    const sizes = [1, 2, 3].map((k) => Math.max(...targets.map((t) => t[k])) - Math.min(...targets.map((t) => t[k])));
    const largest = Math.max(...targets.map((t) => (t[11] ? 0 : t[10]))), wanted = (0.1 * Math.hypot(...sizes)) / (largest || 1);
    const power = Math.pow(10, Math.floor(Math.log10(wanted || 1)));
    const magnify = Math.max(1, [1, 2, 5].map((k) => k * power).filter((k) => k <= wanted).pop() || 1);
    envelopes.push({ name: data.capture, frequency: data.frequency_hz, phase: signed.includes(data.capture), magnify: magnify, targets: targets });
    while (envelopes.length > MOST_ENVELOPES) envelopes.shift();
    at("none").hidden = true;
    show(envelopes, envelopes.length - 1);
    document.body.dataset.seq = event.seq;
  }
  function capture(event) {
    const data = event.data, opened = typeof data.phase_rad === "number";
    if (data.light ? typeof data.light_phase_rad === "number" : data.group && opened) signed.push(data.group || data.capture);
    while (signed.length > MOST_ENVELOPES) signed.shift();
    fill("gauges", (event.data.gauges || []).map((g) => [
      g.gauge, text(g.role), number(g.amplitude_mm, 4), number(g.sd_amplitude_mm, 4), number(g.phase_rad, 3), g.reason || ""]));
  }
  function line(event) {
    const body = at("events").tBodies[0], row = body.insertRow(0), data = event.data || {};
    const about = [data.capture || data.label || data.name, data.device, data.message || data.reason].filter(Boolean).join(" · ");
    cells(row, [new Date(event.at).toLocaleTimeString(), event.kind, about]);
    row.lastChild.className = event.kind === "fault" ? "flags" : "";
    while (body.rows.length > MOST_EVENTS) body.deleteRow(-1);
  }
  const kinds = ["campaign.started", "campaign.paused", "campaign.resumed", "campaign.completed", "campaign.aborted",
    "campaign.failed", "step.started", "step.completed", "step.skipped", "capture.completed", "envelope", "fault"];
  function listen(after) {
    const source = new EventSource(after === null ? "/events" : "/events?after=" + after);
    source.addEventListener("journal", (message) => {
      const about = JSON.parse(message.data);
      if (journal !== null && journal !== about.journal) location.reload(); // another history
      journal = about.journal;
    });
    kinds.forEach((kind) => source.addEventListener(kind, (message) => {
      const event = JSON.parse(message.data);
      line(event);
      if (kind === "envelope") envelope(event);
      if (kind === "capture.completed") capture(event);
      if (kind.startsWith("campaign.")) queue();
    }));
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
    return (await answer.json()).result;
  }
  async function queue() {
    try {
      const found = await ask("/campaigns");
      fill("queue", (found.campaigns || []).map((one) => [text(one.id), text(one.name), one.state + (one.reason ? ": " + one.reason : "")]));
    } catch (problem) { // the next event of a campaign asks again
      fill("queue", []);
    }
  }
  async function beat() {
    try {
      status(await ask("/status"));
      heard = Date.now();
    } catch (problem) {
      if (Date.now() - heard > SILENT_S * 1000) say("The daemon is silent. What is shown is old.");
    }
    setTimeout(beat, 1000);
  }
  async function start() {
    let after = null;
    try { // the last of each kind first, so that the page is never empty on a running rig
      const last = await ask("/latest");
      after = last.last;
      (last.events || []).filter((e) => e.kind === "capture.completed").forEach(capture);
      (last.events || []).filter((e) => e.kind === "envelope").forEach(envelope);
    } catch (problem) { // nothing yet: events will come
      at("none").hidden = false;
    }
    queue();
    listen(after);
    beat();
  }
  start();
})();
