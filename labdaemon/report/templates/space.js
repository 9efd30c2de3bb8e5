// Envelopes in space: drag to turn, wheel or slider to magnify, play where the phase is known. No library.
// spaceView(view) gives a function that shows a list of captures: the page of results calls it once, the live page again and again.
"use strict";
function spaceView(view) {
  let data = [];
  const canvas = view.querySelector("canvas"), pick = view.querySelector("select"), play = view.querySelector(".play");
  const slider = view.querySelector("input"), note = view.querySelector(".note");
  const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const home = { turn: -0.6, tilt: 0.35, zoom: 1 };
  let eye = Object.assign({}, home), now = 0, time = 0, running = false, last = 0;
  const stops = [[59, 111, 182], [108, 92, 201], [170, 71, 188], [222, 66, 118], [233, 84, 52]];
  const colour = (share) => {
    const place = Math.min(Math.max(share, 0), 1) * 4, low = Math.min(Math.floor(place), 3), part = place - low;
    return "rgb(" + stops[low].map((c, i) => Math.round(c + (stops[low + 1][i] - c) * part)).join(",") + ")";
  };
  function show(index) {
    now = index;
    slider.value = Math.log10(data[now].magnify);
    play.disabled = false;
    draw();
  }
  function draw() {
    const capture = data[now], ratio = window.devicePixelRatio || 1, width = view.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const pen = canvas.getContext("2d"), style = getComputedStyle(document.documentElement);
    pen.scale(ratio, ratio);
    const magnify = Math.pow(10, slider.value), low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    capture.targets.forEach((t) => [0, 1, 2].forEach((k) => {
      low[k] = Math.min(low[k], t[k + 1]);
      high[k] = Math.max(high[k], t[k + 1]);
    }));
    const middle = low.map((v, k) => (v + high[k]) / 2), size = Math.hypot(...low.map((v, k) => high[k] - v)) || 1;
    const scale = eye.zoom * 0.72 * Math.min(width, height) / size;
    const ct = Math.cos(eye.turn), st = Math.sin(eye.turn), cl = Math.cos(eye.tilt), sl = Math.sin(eye.tilt);
    const place = (x, y, z) => {
      const u = (x - middle[0]) * ct + (y - middle[1]) * st, v = (y - middle[1]) * ct - (x - middle[0]) * st;
      return [width / 2 + scale * u, height / 2 - scale * ((z - middle[2]) * cl + v * sl)];
    };
    const point = (t, angle) => {
      const s = magnify * Math.sin(angle), c = magnify * Math.cos(angle);
      return place(t[1] + s * t[4] + c * t[7], t[2] + s * t[5] + c * t[8], t[3] + s * t[6] + c * t[9]);
    };
    const largest = Math.max(...capture.targets.map((t) => (t[11] ? 0 : t[10])), 1e-9);
    const ink = style.getPropertyValue("--ink"), faint = style.getPropertyValue("--faint");
    pen.font = "11px system-ui,sans-serif";
    [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].forEach(([name, d]) => {
      const o = [34, height - 34], p = place(middle[0] + d[0], middle[1] + d[1], middle[2] + d[2]);
      const q = place(middle[0], middle[1], middle[2]), f = 24 / scale;
      pen.strokeStyle = pen.fillStyle = faint;
      pen.beginPath();
      pen.moveTo(o[0], o[1]);
      pen.lineTo(o[0] + (p[0] - q[0]) * f, o[1] + (p[1] - q[1]) * f);
      pen.stroke();
      pen.fillText(name, o[0] + (p[0] - q[0]) * f * 1.3 - 3, o[1] + (p[1] - q[1]) * f * 1.3 + 4);
    });
    capture.targets.forEach((t) => {
      pen.strokeStyle = pen.fillStyle = colour(t[10] / largest);
      pen.setLineDash(t[11] ? [3, 3] : []);
      pen.lineWidth = 2;
      pen.beginPath();
      for (let k = 0; k <= 36; k++) {
        const [x, y] = point(t, (k * Math.PI) / 18);
        if (k) pen.lineTo(x, y); else pen.moveTo(x, y);
      }
      pen.stroke();
      pen.setLineDash([]);
      const [x, y] = running ? point(t, time) : place(t[1], t[2], t[3]);
      pen.beginPath();
      pen.arc(x, y, running ? 4 : 2.2, 0, 7);
      if (!running) pen.fillStyle = ink;
      pen.fill();
    });
    note.textContent = "Motion × " + Number(magnify.toPrecision(2)) + ", largest " + largest.toPrecision(3) + " mm. " +
      (capture.phase ? "The phase between targets is measured." : "The phase between targets is not known: each path is shown, their common time is not.");
  }
  function step(at) {
    if (!running) return;
    time += ((at - (last || at)) / 1000) * 2 * Math.PI * 0.5;
    last = at;
    draw();
    requestAnimationFrame(step);
  }
  play.addEventListener("click", () => {
    running = !running;
    last = 0;
    play.textContent = running ? "Pause" : "Play";
    if (running) requestAnimationFrame(step); else draw();
  });
  view.querySelectorAll("[data-turn]").forEach((one) => one.addEventListener("click", () => {
    eye = { turn: Number(one.dataset.turn), tilt: Number(one.dataset.tilt), zoom: 1 };
    draw();
  }));
  pick.addEventListener("change", () => show(Number(pick.value)));
  slider.addEventListener("input", draw);
  let held = null;
  canvas.addEventListener("pointerdown", (e) => { held = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", (e) => {
    if (!held) return;
    eye.turn -= (e.clientX - held[0]) * 0.01;
    eye.tilt = Math.min(Math.max(eye.tilt + (e.clientY - held[1]) * 0.01, -1.57), 1.57);
    held = [e.clientX, e.clientY];
    draw();
  });
  ["pointerup", "pointercancel"].forEach((name) => canvas.addEventListener(name, () => { held = null; }));
  canvas.addEventListener("keydown", (e) => {
    const moves = { ArrowLeft: ["turn", 0.1], ArrowRight: ["turn", -0.1], ArrowUp: ["tilt", -0.1], ArrowDown: ["tilt", 0.1] };
    if (moves[e.key]) { eye[moves[e.key][0]] += moves[e.key][1]; e.preventDefault(); draw(); }
    if (e.key === "+" || e.key === "-") { eye.zoom *= e.key === "+" ? 1.1 : 1 / 1.1; draw(); }
    if (e.key === "Home") { eye = Object.assign({}, home); draw(); }
  });
  canvas.addEventListener("wheel", (e) => {
    if (!e.ctrlKey && document.activeElement !== canvas) return; // the page scrolls unless the view has the focus
    eye.zoom *= Math.exp(-e.deltaY * 0.001);
    e.preventDefault();
    draw();
  }, { passive: false });
  window.addEventListener("resize", () => data.length && draw());
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => data.length && draw());
  const size = (capture) => Math.max(...capture.targets.map((t) => (t[11] ? 0 : t[10])));
  return (captures, wanted) => {
    data = captures;
    view.hidden = !data.length;
    if (!data.length) return;
    const options = data.map((capture, index) => {
      const option = document.createElement("option");
      option.value = index;
      option.textContent = capture.name + (capture.frequency ? " · " + Number(capture.frequency.toPrecision(5)) + " Hz" : "");
      return option;
    });
    pick.replaceChildren(...options);
    const first = wanted === undefined ? data.reduce((best, one, k) => (size(one) > size(data[best]) ? k : best), 0) : wanted;
    pick.value = first;
    show(first);
    if (!still && data[first].phase && !running) play.click();
  };
}
