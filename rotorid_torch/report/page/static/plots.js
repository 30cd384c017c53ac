"use strict";
// Flights, one at a time: controls above, each channel measured and modelled with bands, what is left over below.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent), place = document.getElementById("plots");
  const pick = document.getElementById("flight"), group = document.getElementById("group"), said = document.getElementById("plots-said");
  const option = id => document.getElementById(id);
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const unpack = (packed, every = 1, n = 0) => {
    const [low, step, text] = packed, bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0)), steps = new Uint16Array(bytes.buffer);
    const values = Array.from(steps, s => (s === 65535 ? null : low + step * s));
    if (every === 1) return values;
    return Array.from({ length: n }, (_, i) => {
      const k = Math.floor(i / every), f = i / every - k, a = values[Math.min(k, values.length - 1)], b = values[Math.min(k + 1, values.length - 1)];
      return a === null || b === null ? null : a + f * (b - a);
    });
  };
  const smooth = (values, half) => half < 1 ? values : values.map((v, i) => {
    if (v === null) return null;
    let sum = 0, count = 0;
    for (let k = Math.max(0, i - half); k <= Math.min(values.length - 1, i + half); k++) if (values[k] !== null) { sum += values[k]; count++; }
    return sum / count;
  });
  const plus = (a, b, factor) => a.map((v, i) => (v === null || b[i] === null || b[i] === undefined ? null : v + factor * b[i]));
  let charts = [], moving = false;
  const linked = (chart, scale) => {
    if (scale !== "x" || moving) return;
    moving = true;
    const { min, max } = chart.scales.x;
    for (const other of charts) if (other !== chart) other.setScale("x", { min, max });
    moving = false;
  };
  const whole = () => charts.forEach(chart => chart.setScale("x", { min: chart.data[0][0], max: chart.data[0].at(-1) }));
  const options = (width, height, series, bands, bottom) => ({
    width, height, series, bands, legend: { show: false }, padding: [6, 8, bottom ? 0 : 8, 0],
    cursor: { sync: { key: "flight", setSeries: false }, drag: { x: true, y: false }, points: { size: 5 } },
    scales: { x: { time: false }, y: { range: (_, low, high) => (low < high ? uPlot.rangeNum(low, high, 0.1, true) : [(low ?? 0) - 1, (low ?? 0) + 1]) } },
    hooks: { setScale: [linked], setCursor: [read] },
    axes: [
      { show: bottom, stroke: colour("quiet"), grid: { stroke: colour("rule"), width: 0.5 }, ticks: { show: false }, size: 26, font: "12px system-ui", label: undefined },
      { stroke: colour("quiet"), grid: { stroke: colour("rule"), width: 0.5 }, ticks: { show: false }, size: 58, space: height < 100 ? 16 : 28, font: "12px system-ui" },
    ],
  });
  function read(chart) {
    const i = chart.cursor.idx;
    if (!chart.readout) return;
    const parts = i === null || i === undefined ? [] : [`t ${chart.data[0][i].toFixed(2)} s`, ...chart.told.map(([word, k]) => `${word} ${chart.data[k][i] === null || chart.data[k][i] === undefined ? "–" : chart.data[k][i].toPrecision(4)}`)];
    chart.readout.textContent = parts.join(" · ");
  }
  const add = (holder, opts, rows, readout, told) => {
    const chart = new uPlot(opts, rows, holder);
    chart.readout = readout; chart.told = told;
    chart.over.addEventListener("dblclick", whole);
    charts.push(chart);
  };
  const heading = (holder, text) => {
    const head = document.createElement("h3"), value = document.createElement("span");
    value.className = "value";
    head.append(text + " ", value);
    holder.append(head);
    return value;
  };
  const line = (stroke, width = 1.5, dash) => ({ stroke: colour(stroke), width, dash, points: { show: false } });
  const stroke = (look, dash = []) => {
    const picture = document.createElement("span");
    picture.innerHTML = `<svg width="26" height="8" aria-hidden="true"><path d="M0 4H26" stroke="${colour(look)}" stroke-width="1.5" stroke-dasharray="${dash.join(" ")}"/></svg>`;
    return picture;
  };
  const edge = () => ({ stroke: "transparent", width: 0, points: { show: false } });
  const draw = () => {
    charts.forEach(chart => chart.destroy());
    charts = [];
    place.replaceChildren();
    const flight = data.flights[pick.value], time = Array.from({ length: flight.n }, (_, i) => flight.t0 + i * flight.dt);
    const padded = values => (values.length < flight.n ? values.concat(Array(flight.n - values.length).fill(null)) : values.slice(0, flight.n));
    const columns = matchMedia("(min-width: 70rem)").matches ? 2 : 1, width = Math.floor((place.clientWidth - 24 * (columns - 1)) / columns);
    const half = option("smooth").checked ? Math.round(0.1 / flight.dt) : 0;
    const panel = (title, alt) => {
      const holder = document.createElement("div");
      holder.className = "plot"; holder.setAttribute("role", "img"); holder.setAttribute("aria-label", alt);
      place.append(holder);
      return [holder, heading(holder, title)];
    };
    const every = Object.keys(flight.controls), unitOf = name => data.controls[name].unit;
    for (const unit of new Set(every.map(unitOf))) {
      const names = every.filter(name => unitOf(name) === unit);
      const dashes = [undefined, [8, 4], [2, 3], [10, 3, 2, 3]], colours = ["control", "measured", "model", "before"];
      const [holder, readout] = panel(`Controls, from their start (${unit}):`, `Controls of ${flight.name} over time: ${names.join(", ")}`);
      names.forEach((name, k) => readout.before(stroke(colours[k % 4], dashes[k % 4]), ` ${name} `));
      const rows = names.map(name => { const v = padded(unpack(flight.controls[name])), first = v.find(x => x !== null) ?? 0; return v.map(x => (x === null ? null : x - first)); });
      add(holder, options(width, 130, [{}, ...names.map((_, k) => line(colours[k % 4], 1.5, dashes[k % 4]))], [], true), [time, ...rows], readout, names.map((name, k) => [name, k + 1]));
    }
    const wanted = group.value === "all" ? Object.keys(flight.channels) : data.groups[group.value].filter(name => name in flight.channels);
    let sum = 0;
    for (const name of wanted) {
      const of = flight.channels[name], about = data.channels[name];
      const [holder, readout] = panel(`${name}, ${about.unit} – ${about.about}`, `${about.about} of ${flight.name} over time, measured and modelled, with the residual below`);
      const measured = smooth(padded(unpack(of.m)), half), model = padded(unpack(of.a)), before = of.b && option("before") && option("before").checked ? padded(unpack(of.b)) : null;
      const series = [{}], rows = [time], bands = [], put = (spec, values) => { series.push(spec); rows.push(values); return rows.length - 1; };
      if (option("bands").checked) {
        if (of.s) { const s = unpack(of.s, 8, flight.n), up = put(edge(), plus(model, s, 2)), down = put(edge(), plus(model, s, -2)); bands.push({ series: [up, down], fill: colour("band") }); }
        if (about.noise) { const up = put(edge(), measured.map(v => (v === null ? null : v + 2 * about.noise))), down = put(edge(), measured.map(v => (v === null ? null : v - 2 * about.noise))); bands.push({ series: [up, down], fill: colour("noise") }); }
      }
      const told = [["measured", put(line("measured", 1), measured)]];
      if (before) told.push(["before", put(line("before", 1.5, [6, 4]), before)]);
      told.push(["model", put(line("model", 2), model)]);
      add(holder, options(width, 150, series, bands, false), rows, readout, told);
      const left = plus(measured, model, -1), residual = [{}, line("quiet", 1), line("model", 1.2)];
      const zero = time.map(() => 0), lines = [time, zero, left];
      if (before) { residual.push(line("before", 1.2, [6, 4])); lines.push(plus(measured, before, -1)); }
      add(holder, options(width, 78, residual, [], true), lines, null, []);
      sum += 1;
    }
    said.textContent = `${flight.name} (${flight.list}): ${sum} channel${sum === 1 ? "" : "s"}. Drag to zoom all, double click for the whole flight.`;
  };
  data.flights.forEach((flight, k) => pick.add(new Option(`${flight.name} (${flight.list})`, k)));
  pick.value = String(Math.max(data.flights.findIndex(flight => flight.name === data.flight), 0));
  Object.keys(data.groups).forEach(name => group.add(new Option(name, name, false, data.groups[name].includes(data.channel))));
  group.add(new Option("all", "all"));
  for (const id of ["flight", "group", "smooth", "bands", "before"]) option(id)?.addEventListener("change", draw);
  document.getElementById("whole").addEventListener("click", whole);
  const step = by => { pick.value = String((Number(pick.value) + by + data.flights.length) % data.flights.length); draw(); };
  document.getElementById("previous").addEventListener("click", () => step(-1));
  document.getElementById("next").addEventListener("click", () => step(1));
  let waiting;
  addEventListener("resize", () => { clearTimeout(waiting); waiting = setTimeout(draw, 200); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  draw();
})();
