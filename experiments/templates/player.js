// Plays two agents in the same scenario, side by side. Data: see reporting/showcase.py. No library, no network.
(() => {
  "use strict";
  const section = document.getElementById("player");
  if (!section) return;
  const places = JSON.parse(document.getElementById("films-data").textContent);
  const films = places.flatMap((place) => place.films.map((film) => ({ place, film })));
  const part = (name) => section.querySelector(`[data-part="${name}"]`);
  const ARMS = ["control", "treatment"];
  const COLOURS = { control: "#0072b2", treatment: "#d55e00" };
  const LENGTH = 5, WIDTH = 2; // [m] of a car
  const STEP = 0.2; // [s] of the arrow keys
  const FRAME = 33; // [ms] between two frames
  const KINDS = { control: "Only the control agent crashes", treatment: "Only the treated agent crashes", both: "Both agents crash" };
  let current = null, time = 0, playing = false, before = 0;

  const sums = (values) => { let sum = 0; return values.map((value) => (sum += value)); };
  const unpack = (track) => ({
    ...track,
    times: track.times.map((value) => value / 100),
    cars: track.cars.map((car) => ({
      from: car.from, acts: new Set(car.acts || []), x: sums(car.x).map((v) => v / 10), y: sums(car.y).map((v) => v / 10), h: sums(car.h).map((v) => v / 100),
    })),
  });

  /** The frame before a time, and the share of the way to the next one. */
  function at(track, t) {
    const last = track.times.length - 1;
    if (t >= track.times[last]) return [last, 0];
    let frame = 0;
    while (track.times[frame + 1] <= t) frame += 1;
    return [frame, (t - track.times[frame]) / (track.times[frame + 1] - track.times[frame])];
  }

  /** Where a car is [m, m, rad], or null while it is not near the ego. */
  function pose(car, frame, share) {
    const k = frame - car.from;
    if (k < 0 || k >= car.x.length) return null;
    const next = Math.min(k + 1, car.x.length - 1);
    return ["x", "y", "h"].map((name) => car[name][k] + share * (car[name][next] - car[name][k]));
  }

  function camera(place, ego, width, height) {
    if (place.follow) {
      const scale = width / (place.flat ? 120 : 95);
      return { scale, x: width * (place.flat ? 0.38 : 0.5) - ego[0] * scale, y: height / 2 - (place.flat ? place.view[1] : ego[1]) * scale };
    }
    const [x, y, across, down] = place.view;
    const scale = Math.min(width / (across + 40), height / (down + 40));
    return { scale, x: width / 2 - x * scale, y: height / 2 - y * scale };
  }

  function polygon(pen, values) {
    pen.beginPath();
    for (let k = 0; k < values.length; k += 2) pen.lineTo(values[k] / 10, values[k + 1] / 10);
    pen.closePath();
  }

  function drawRoad(pen, road) {
    pen.strokeStyle = "#f4f5f3"; pen.lineWidth = 0.7; pen.lineJoin = "round";
    for (const surface of road.surfaces) { polygon(pen, surface); pen.stroke(); }
    pen.fillStyle = "#757b84";
    for (const surface of road.surfaces) { polygon(pen, surface); pen.fill(); }
    pen.lineWidth = 0.3; pen.beginPath();
    for (const [x1, y1, x2, y2] of road.dashes) { pen.moveTo(x1 / 10, y1 / 10); pen.lineTo(x2 / 10, y2 / 10); }
    pen.stroke();
  }

  function drawCar(pen, [x, y, h], fill, edge, ghost) {
    pen.save();
    pen.translate(x, y); pen.rotate(h);
    pen.beginPath();
    if (pen.roundRect) pen.roundRect(-LENGTH / 2, -WIDTH / 2, LENGTH, WIDTH, 0.5); else pen.rect(-LENGTH / 2, -WIDTH / 2, LENGTH, WIDTH);
    pen.lineWidth = ghost ? 0.35 : 0.2; pen.strokeStyle = edge;
    if (ghost) { pen.setLineDash([0.7, 0.5]); pen.stroke(); pen.restore(); return; }
    pen.fillStyle = fill; pen.fill(); pen.stroke();
    pen.fillStyle = "rgba(20, 26, 34, .75)"; pen.fillRect(0.4, -0.8, 0.8, 1.6); pen.fillRect(-1.9, -0.7, 0.4, 1.4);
    pen.restore();
  }

  function ring(pen, [x, y], colour, radius, scale) {
    pen.strokeStyle = colour; pen.lineWidth = Math.max(0.5, 3 / scale);
    pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); pen.stroke();
  }

  function draw(arm) {
    const canvas = part(`screen-${arm}`), { place } = current, track = current[arm], other = current[arm === "control" ? "treatment" : "control"];
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d"), [frame, share] = at(track, time), ego = pose(track.cars[0], frame, share);
    const { scale, x, y } = camera(place, ego, width, height);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = "#cdd5c6"; pen.fillRect(0, 0, width, height);
    pen.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * x, ratio * y);
    drawRoad(pen, place.road);
    pen.strokeStyle = COLOURS[arm]; pen.globalAlpha = 0.55; pen.lineWidth = 0.5; pen.beginPath();
    for (let k = 0; k <= frame; k += 1) pen.lineTo(track.cars[0].x[k], track.cars[0].y[k]);
    pen.lineTo(ego[0], ego[1]); pen.stroke(); pen.globalAlpha = 1;
    const crashed = track.crash !== null && time >= track.crash - 1e-6;
    track.cars.forEach((car, number) => {
      const where = number > 0 ? pose(car, frame, share) : null;
      if (!where) return;
      const acts = car.acts.has(frame); // a risk event acts on this car
      drawCar(pen, where, crashed && number === track.hit ? "#e5484d" : acts ? "#ffc400" : "#e9edf1", "#2b3138");
      if (acts) ring(pen, where, "#ffc400", 4, scale);
    });
    const ghost = pose(other.cars[0], ...at(other, time));
    drawCar(pen, ghost, "", COLOURS[arm === "control" ? "treatment" : "control"], true);
    drawCar(pen, ego, COLOURS[arm], "#ffffff");
    if (crashed) ring(pen, ego, "#c81e1e", 5.5, scale);
    const over = time >= track.times[track.times.length - 1] - 1e-6;
    const speed = (track.speeds[frame] / 10).toFixed(0);
    part(`state-${arm}`).textContent = crashed ? `crashed at ${track.crash.toFixed(1)} s` : over ? "over" : `${speed} m/s`;
    part(`state-${arm}`).className = crashed ? "crashed" : "";
  }

  function show(t) {
    time = Math.min(Math.max(t, 0), current.end);
    const slider = part("time");
    slider.value = String(time);
    slider.setAttribute("aria-valuetext", `${time.toFixed(1)} of ${current.end.toFixed(1)} seconds`);
    part("clock").textContent = `${time.toFixed(1)} s`;
    section.dataset.time = time.toFixed(1);
    ARMS.forEach(draw);
  }

  function tick() {
    if (!playing) return;
    const now = performance.now();
    show(time + Math.min((now - before) / 1000, 0.1) * Number(part("rate").value));
    before = now;
    if (time >= current.end) play(false); else window.setTimeout(tick, FRAME);
  }

  function play(on) {
    playing = on;
    part("play").textContent = on ? "Pause" : "Play";
    section.dataset.playing = String(on);
    if (!on) return;
    if (time >= current.end) show(0);
    before = performance.now();
    window.setTimeout(tick, FRAME);
  }

  function choose(number) {
    const { place, film } = films[number];
    current = { number, place, control: unpack(film.control), treatment: unpack(film.treatment) };
    current.end = Math.max(...ARMS.map((arm) => current[arm].times[current[arm].times.length - 1]));
    part("task").selectedIndex = places.indexOf(place);
    for (const option of part("film").options) option.hidden = option.disabled = films[option.value].place !== place;
    part("film").value = String(number);
    part("time").max = String(current.end);
    section.classList.toggle("flat", place.flat && place.follow);
    for (const arm of ARMS) {
      part(`screen-${arm}`).setAttribute("aria-label", `${arm} agent on ${place.task}, ${film.traffic} scenario ${film.scenario}: ${film[arm].ending}`);
      part(`ending-${arm}`).textContent = `In the end: ${film[arm].ending}.`;
    }
    play(false);
    show(Math.min(...ARMS.map((arm) => current[arm].crash ?? Infinity)) - 2); // two seconds before the first crash
  }

  for (const place of places) part("task").add(new Option(`${place.task} ${place.level_name} (${place.backend})`));
  films.forEach(({ film }, number) => part("film").add(new Option(`${KINDS[film.kind]} (${film.traffic} traffic, scenario ${film.scenario})`, number)));
  part("task").addEventListener("change", (event) => choose(films.findIndex(({ place }) => place === places[event.target.selectedIndex])));
  part("film").addEventListener("change", (event) => choose(Number(event.target.value)));
  part("next").addEventListener("click", () => choose((current.number + 1) % films.length));
  part("play").addEventListener("click", () => play(!playing));
  part("time").addEventListener("input", (event) => { play(false); show(Number(event.target.value)); });
  section.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
    const keys = {
      " ": () => part("play").click(),
      ArrowRight: () => { play(false); show(time + STEP); },
      ArrowLeft: () => { play(false); show(time - STEP); },
    };
    if (event.key === " " && event.target.tagName === "BUTTON") return; // a button answers to the space bar itself
    if (keys[event.key]) { event.preventDefault(); keys[event.key](); }
  });
  window.addEventListener("resize", () => show(time));
  section.hidden = false;
  choose(0);
})();
