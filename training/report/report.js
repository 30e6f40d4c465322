"use strict";
(function () {
  const root = document.documentElement;
  root.classList.add("js");
  const byId = (id) => document.getElementById(id);
  const facts = JSON.parse(byId("facts").textContent);
  const LOOKS = {
    "measurement": ["#7a7a7a", "#a8a8a8", "x"], "single filter": ["#0072B2", "#56B4E9", "circle"],
    "adaptive filter": ["#00795a", "#3fc79f", "square"], "bank": ["#b84700", "#ff8f4a", "diamond"],
    "Jink": ["#8f3f78", "#e59acb", "star"], "limit": ["#16191d", "#eceff2", "line-ns-open"],
    "other": ["#8a6a00", "#e6c229", "triangle-up"],
  };
  const LINES = [
    ["#0072B2", "#56B4E9", "solid", "circle"], ["#b84700", "#ff8f4a", "dash", "diamond"],
    ["#00795a", "#3fc79f", "dot", "square"], ["#8f3f78", "#e59acb", "solid", "star"],
    ["#8a6a00", "#e6c229", "dashdot", "triangle-up"], ["#4d5761", "#b4bdc6", "longdash", "x"],
    ["#7b241c", "#f1948a", "longdashdot", "cross"], ["#1b4f72", "#85c1e9", "dot", "hexagon"],
  ];
  const SHOWN = ["kf-cv", "imm", "robust-imm", "intent-imm", "joint-imm", "agent", "oracle"];
  let scene = 0, data = null, player = null;

  function dark() {
    const chosen = root.getAttribute("data-theme");
    return chosen ? chosen === "dark" : window.matchMedia("(prefers-color-scheme: dark)").matches;
  }
  const ink = (name) => getComputedStyle(root).getPropertyValue(name).trim();
  const narrow = () => window.innerWidth < 700;
  const short = (v) => (v === null || v === undefined ? "–" : Number(v).toPrecision(4).replace(/\.?0+$/, ""));

  function layout(more) {
    const grid = { gridcolor: ink("--line"), zerolinecolor: ink("--line"), linecolor: ink("--quiet"), automargin: true };
    const base = {
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: ink("--text"), size: narrow() ? 11 : 13 },
      margin: { l: 60, r: 14, t: 36, b: 48 }, showlegend: true, hovermode: "closest",
      hoverlabel: { bgcolor: ink("--panel"), font: { color: ink("--text") }, bordercolor: ink("--line") },
      legend: narrow() ? { orientation: "h", y: -0.3, x: 0, yanchor: "top" } : { x: 1.01, y: 1, font: { size: 12 } },
      modebar: { bgcolor: "rgba(0,0,0,0)", color: ink("--quiet"), activecolor: ink("--text"), orientation: "h" }, xaxis: grid, yaxis: grid,
    };
    const out = Object.assign(base, more);
    for (const axis of ["xaxis", "yaxis", "yaxis2", "yaxis3"]) if (out[axis]) out[axis] = Object.assign({}, grid, out[axis]);
    return out;
  }
  const CONFIG = { responsive: true, displaylogo: false, showSendToCloud: false,
    modeBarButtonsToRemove: ["lasso2d", "select2d", "autoScale2d"] };
  function draw(id, traces, more) {
    const place = byId(id);
    if (place) Plotly.react(place, traces, layout(more), Object.assign({ displayModeBar: narrow() ? false : "hover" }, CONFIG));
  }
  function show(id, on) { const place = byId(id); if (place) place.hidden = !on; }
  function lookOf(family) { const look = LOOKS[family] || LOOKS.other; return [dark() ? look[1] : look[0], look[2]]; }
  function lineOf(name, names) {
    // The same estimator looks the same in every plot of a scenario.
    const every = data.rungs.map((r) => r.name), shown = SHOWN.filter((n) => every.includes(n));
    const look = LINES[[...shown, ...every.filter((n) => !shown.includes(n))].indexOf(name) % LINES.length];
    const some = names.some((n) => shown.includes(n));
    return { color: dark() ? look[1] : look[0], dash: look[2], symbol: look[3], visible: some && !shown.includes(name) ? "legendonly" : true };
  }
  const unitOf = (unit) => (unit ? ", " + unit : "");

  function drawLadder() {
    const metric = byId("metric").value;
    const known = data.rungs.filter((r) => r.values[metric] && r.values[metric][0] !== null);
    const families = [...new Set(known.map((r) => r.family))];
    const traces = families.map((family) => {
      const some = known.filter((r) => r.family === family), [color, symbol] = lookOf(family);
      const value = (r) => r.values[metric];
      return {
        type: "scatter", mode: "markers", name: family, x: some.map((r) => value(r)[0]), y: some.map((r) => r.name),
        marker: { color, symbol, size: 11, line: { width: symbol === "line-ns-open" ? 3 : 1, color } },
        error_x: { type: "data", symmetric: false, color, thickness: 2, width: 5,
          array: some.map((r) => (value(r)[2] === null ? 0 : value(r)[2] - value(r)[0])),
          arrayminus: some.map((r) => (value(r)[1] === null ? 0 : value(r)[0] - value(r)[1])) },
        text: some.map((r) => short(value(r)[0]) + " [" + short(value(r)[1]) + ", " + short(value(r)[2]) + "]" +
          (r.status === "ok" ? "" : "; " + r.status)),
        hovertemplate: "%{y}: %{text}<extra></extra>",
      };
    });
    const info = data.metrics[metric], values = known.map((r) => r.values[metric][0]);
    const log = Math.min(...values) > 0 && Math.max(...values) / Math.min(...values) > 8;
    const order = known.map((r) => r.name).reverse();
    byId("ladder-line").textContent = info.line + (log ? ". Logarithmic axis." : ".");
    byId("ladder").style.height = Math.max(340, 30 * known.length + 130) + "px";
    const limit = known.find((r) => r.name === "oracle");
    draw("ladder", traces, {
      xaxis: { title: { text: metric.replaceAll("_", " ") + unitOf(info.unit) }, type: log ? "log" : "linear" },
      yaxis: { categoryorder: "array", categoryarray: order, type: "category" },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, margin: { l: 60, r: 14, t: 40, b: 48 },
      shapes: limit ? [{ type: "line", yref: "paper", y0: 0, y1: 1, x0: limit.values[metric][0], x1: limit.values[metric][0],
        line: { color: ink("--quiet"), width: 1, dash: "dot" } }] : [],
    });
  }

  function drawCurve(id, metric, axis, more) {
    const curve = data.curves[metric];
    show(id + "-part", Boolean(curve));
    if (!curve) return;
    const names = Object.keys(curve.lines);
    const traces = names.map((name) => {
      const look = lineOf(name, names), [at, values] = curve.lines[name];
      const every = Math.max(1, Math.round(at.length / 8)), offset = names.indexOf(name) % every;
      return { type: "scatter", mode: "lines+markers", name, x: at, y: values, visible: look.visible, line: { color: look.color, dash: look.dash, width: 2 },
        marker: { symbol: look.symbol, size: at.map((_, i) => (i % every === offset ? 8 : 0.01)), color: look.color, line: { width: 0 } },
        hovertemplate: name + ": %{y:.4g} at %{x:.3g} s<extra></extra>" };
    });
    const shapes = [];
    if (curve.low !== null && curve.high !== null) {
      const xs = Object.values(curve.lines)[0][0];
      shapes.push({ type: "rect", x0: xs[0], x1: xs[xs.length - 1], y0: curve.low, y1: curve.high, fillcolor: ink("--band"), line: { width: 0 }, layer: "below" });
    }
    if (more.event) shapes.push({ type: "line", yref: "paper", y0: 0, y1: 1, x0: 0, x1: 0, line: { color: ink("--quiet"), dash: "dot", width: 1.5 } });
    draw(id, traces, { xaxis: { title: { text: axis } }, yaxis: Object.assign({ title: { text: more.label + unitOf(curve.unit) } }, more.y), shapes });
  }

  function drawCost() {
    const known = data.rungs.filter((r) => r.values.microseconds_per_step && r.values.position_rmse && r.values.position_rmse[0] !== null);
    show("cost-part", known.length > 1);
    if (known.length < 2) return;
    const families = [...new Set(known.map((r) => r.family))];
    const traces = families.map((family) => {
      const some = known.filter((r) => r.family === family), [color, symbol] = lookOf(family);
      return { type: "scatter", mode: narrow() ? "markers" : "markers+text", name: family, x: some.map((r) => r.values.microseconds_per_step[0]),
        y: some.map((r) => r.values.position_rmse[0]), text: some.map((r) => r.name), textposition: some.map((_, i) => ["top center", "bottom center", "middle right"][i % 3]),
        textfont: { size: 11 }, marker: { color, symbol, size: 12, line: { width: symbol === "line-ns-open" ? 3 : 1, color } },
        error_y: { type: "data", symmetric: false, color, thickness: 1.5, width: 4, array: some.map((r) => r.values.position_rmse[2] - r.values.position_rmse[0]),
          arrayminus: some.map((r) => r.values.position_rmse[0] - r.values.position_rmse[1]) },
        hovertemplate: "%{text}: %{y:.4g} m at %{x:.3g} us a step<extra></extra>" };
    });
    draw("cost", traces, { xaxis: { title: { text: "microseconds a step, one thread" }, type: "log" }, yaxis: { title: { text: "position rmse, m" }, type: "log" },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, margin: { l: 60, r: 14, t: 40, b: 48 } });
  }

  function ellipse(x, y, a, b, c) {
    const half = (a + c) / 2, root2 = Math.sqrt(Math.max(((a - c) / 2) ** 2 + b * b, 0)), angle = 0.5 * Math.atan2(2 * b, a - c);
    const k = 2.4477, l1 = k * Math.sqrt(Math.max(half + root2, 0)), l2 = k * Math.sqrt(Math.max(half - root2, 0)), xs = [], ys = [];
    for (let i = 0; i <= 40; i++) {
      const t = (2 * Math.PI * i) / 40, u = l1 * Math.cos(t), v = l2 * Math.sin(t);
      xs.push(x + u * Math.cos(angle) - v * Math.sin(angle)); ys.push(y + u * Math.sin(angle) + v * Math.cos(angle));
    }
    return [xs, ys];
  }
  function chosenPlayers() { return [byId("who").value, byId("other").value].filter((n, i, a) => n && a.indexOf(n) === i); }
  const playLook = (i) => { const look = LINES[[0, 1][i]]; return { color: dark() ? look[1] : look[0], dash: look[2], symbol: look[3] }; };

  function startPlayer() {
    const play = data.play;
    show("play-part", Boolean(play));
    stopPlayer();
    if (!play) return;
    const names = Object.keys(play.estimators);
    for (const [id, first] of [["who", ["agent", "joint-imm", "intent-imm"]], ["other", ["imm", "kf-cv"]]]) {
      const select = byId(id), before = select.value;
      select.replaceChildren();
      if (id === "other") select.add(new Option("nobody", ""));
      for (const name of names) select.add(new Option(name, name));
      select.value = names.includes(before) ? before : first.find((n) => names.includes(n)) || names[0];
    }
    byId("time").max = play.times.length - 1;
    drawPlayer();
  }
  function drawPlayer() {
    const play = data.play, all = chosenPlayers(), worst = [];
    const traces = [{ type: "scatter", mode: "lines", name: "truth, whole run", x: play.true[0], y: play.true[1], line: { color: ink("--line"), width: 2 }, hoverinfo: "skip" }];
    const measured = play.measured || [[], []];
    traces.push({ type: "scatter", mode: "markers", name: "measured", x: [], y: [], marker: { color: ink("--quiet"), size: 5, symbol: "x-thin-open" }, hovertemplate: "measured (%{x:.4g}, %{y:.4g}) m<extra></extra>" });
    traces.push({ type: "scatter", mode: "lines", name: "truth", x: [], y: [], line: { color: ink("--text"), width: 2.5 }, hoverinfo: "skip" });
    all.forEach((name, i) => {
      const look = playLook(i);
      traces.push({ type: "scatter", mode: "lines", name, x: [], y: [], line: { color: look.color, width: 2.5, dash: look.dash }, hoverinfo: "skip" });
      traces.push({ type: "scatter", mode: "lines", name: name + ", 95 % ellipse", showlegend: false, x: [], y: [], line: { color: look.color, width: 1.5 }, fill: "toself", fillcolor: "rgba(128,128,128,0.15)", hoverinfo: "skip" });
    });
    traces.push({ type: "scatter", mode: "markers", name: "now", showlegend: false, x: [], y: [], marker: { size: 13, symbol: ["circle-open", ...all.map((_, i) => playLook(i).symbol)], color: [ink("--text"), ...all.map((_, i) => playLook(i).color)], line: { width: 2 } }, hoverinfo: "skip" });
    const good = (v) => v.filter((x) => x !== null);
    const xs = good(play.true[0]), ys = good(play.true[1]);
    const span = Math.max(Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys), 1) * 0.56;
    const cx = (Math.max(...xs) + Math.min(...xs)) / 2, cy = (Math.max(...ys) + Math.min(...ys)) / 2;
    const box = byId("map").getBoundingClientRect(), stretch = Math.max((box.width || 600) / 460, 0.6);
    draw("map", traces, { xaxis: { title: { text: "x, m" }, range: [cx - span * stretch, cx + span * stretch] }, yaxis: { title: { text: "y, m" }, scaleanchor: "x", range: [cy - span, cy + span] },
      legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, margin: { l: 60, r: 10, t: 40, b: 44 } });
    const strips = all.map((name, i) => {
      const look = playLook(i), one = play.estimators[name];
      worst.push(...good(one.error));
      return { type: "scatter", mode: "lines", name, x: play.times, y: one.error, line: { color: look.color, dash: look.dash, width: 2 }, hovertemplate: name + ": %{y:.4g} m at %{x:.4g} s<extra></extra>" };
    });
    const shapes = [{ type: "line", x0: play.times[0], x1: play.times[0], yref: "paper", y0: 0, y1: 1, line: { color: ink("--text"), width: 1.5 } }];
    if (play.scale) {
      let from = null;
      play.scale.forEach((s, i) => {
        const loud = s !== null && s > 1.5;
        if (loud && from === null) from = play.times[i];
        if ((!loud || i === play.scale.length - 1) && from !== null) {
          shapes.push({ type: "rect", x0: from, x1: play.times[i], yref: "paper", y0: 0, y1: 1, fillcolor: ink("--surge"), line: { width: 0 }, layer: "below" });
          from = null;
        }
      });
      strips.push({ type: "scatter", mode: "lines", name: "noise, times R", x: play.times, y: play.scale, yaxis: "y2", line: { color: ink("--quiet"), width: 2, shape: "hv" }, hovertemplate: "R times %{y:.3g} at %{x:.4g} s<extra></extra>" });
    }
    for (const t of play.switches) shapes.push({ type: "line", x0: t, x1: t, yref: "paper", y0: 0, y1: 1, line: { color: ink("--quiet"), width: 1, dash: "dot" } });
    let third = false;
    if (play.intents.length > 1) {
      third = true;
      const named = (list) => list.map((i) => (i === null || i === undefined ? null : play.intents[i]));
      strips.push({ type: "scatter", mode: "lines", name: "true intent", x: play.times, y: named(play.intent || []), yaxis: "y3", line: { color: ink("--text"), width: 5, shape: "hv" }, opacity: 0.35, hovertemplate: "true: %{y} at %{x:.4g} s<extra></extra>" });
      all.forEach((name, i) => {
        const said = play.estimators[name].intent, look = playLook(i);
        if (said) strips.push({ type: "scatter", mode: "lines", name: name + " believes", showlegend: false, x: play.times, y: named(said), yaxis: "y3", line: { color: look.color, width: 2, dash: look.dash, shape: "hv" }, hovertemplate: name + ": %{y} at %{x:.4g} s<extra></extra>" });
      });
    }
    all.forEach((name, i) => {
      const said = play.estimators[name].surge, look = playLook(i);
      if (said && play.scale) strips.push({ type: "scatter", mode: "lines", name: name + ": P(surge)", x: play.times, y: said.map((p) => (p === null ? null : Math.pow(10, 4 * p))), yaxis: "y2", line: { color: look.color, width: 1, dash: "dot" }, visible: "legendonly", customdata: said, hovertemplate: "P(surge) %{customdata:.2f} at %{x:.4g} s<extra></extra>" });
    });
    const top = play.scale ? (third ? [0.62, 1] : [0.45, 1]) : third ? [0.42, 1] : [0, 1];
    const more = { xaxis: { title: { text: "time, s" }, anchor: third ? "y3" : play.scale ? "y2" : "y" }, yaxis: { title: { text: "error, m" }, domain: top, type: "log" }, shapes, margin: { l: 90, r: 10, t: 40, b: 44 }, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 } };
    if (play.scale) more.yaxis2 = { title: { text: "times R" }, type: "log", domain: third ? [0.34, 0.56] : [0, 0.36] };
    if (third) more.yaxis3 = { type: "category", categoryorder: "array", categoryarray: play.intents, domain: play.scale ? [0, 0.28] : [0, 0.34] };
    draw("strips", strips, more);
    seek(Number(byId("time").value), measured);
  }
  function seek(k, given) {
    const play = data.play, measured = given || play.measured || [[], []], all = chosenPlayers(), upto = (v) => v.slice(0, k + 1);
    const xs = [upto(measured[0]), upto(play.true[0])], ys = [upto(measured[1]), upto(play.true[1])], at = [1, 2];
    const nowX = [play.true[0][k]], nowY = [play.true[1][k]];
    let line = "t = " + short(play.times[k]) + " s";
    if (play.intent && play.intent[k] !== null) line += ", true intent " + play.intents[play.intent[k]];
    if (play.scale && play.scale[k] !== null) line += ", noise " + short(play.scale[k]) + " x R";
    all.forEach((name, i) => {
      const one = play.estimators[name], [x, y] = one.place;
      xs.push(upto(x)); ys.push(upto(y)); at.push(3 + 2 * i);
      const c = one.cov, [ex, ey] = c && c[0][k] !== null ? ellipse(x[k], y[k], c[0][k], c[1][k], c[2][k]) : [[], []];
      xs.push(ex); ys.push(ey); at.push(4 + 2 * i);
      nowX.push(x[k]); nowY.push(y[k]);
      line += "; " + name + " " + short(one.error[k]) + " m off";
      if (one.intent && one.intent[k] !== null) line += ", believes " + play.intents[one.intent[k]];
      if (one.surge) line += ", P(surge) " + (one.surge[k] === null ? "–" : one.surge[k].toFixed(2));
    });
    xs.push(nowX); ys.push(nowY); at.push(3 + 2 * all.length);
    Plotly.restyle("map", { x: xs, y: ys }, at);
    Plotly.relayout("strips", { "shapes[0].x0": play.times[k], "shapes[0].x1": play.times[k] });
    byId("now").textContent = line;
    byId("time").value = k;
    byId("time").setAttribute("aria-valuetext", short(play.times[k]) + " seconds");
  }
  function stopPlayer() { if (player) { clearInterval(player); player = null; } const b = byId("play"); if (b) b.textContent = "Play"; }
  function togglePlayer() {
    if (player) { stopPlayer(); return; }
    if (Number(byId("time").value) >= data.play.times.length - 1) seek(0);
    byId("play").textContent = "Pause";
    player = setInterval(() => {
      const k = Number(byId("time").value) + 1;
      if (k >= data.play.times.length) stopPlayer(); else seek(k);
    }, 80);
  }

  function drawAll() {
    const select = byId("metric"), before = select.value, names = Object.keys(data.metrics);
    show("plots", names.length > 0);
    if (!names.length) return;
    select.replaceChildren(...names.map((n) => new Option(n.replaceAll("_", " "), n)));
    select.value = names.includes(before) ? before : names.includes("position_rmse") ? "position_rmse" : names[0];
    drawLadder();
    const log = { type: "log" }, share = { range: [0, 1.02] };
    drawCurve("switch", "error_after_switch", "seconds after the switch", { label: "error", event: true, y: log });
    drawCurve("surge", "error_after_surge", "seconds after the surge begins", { label: "error", event: true, y: log });
    drawCurve("whole", "error_over_time", "time, s", { label: "error", y: log });
    drawCurve("nees", "nees_over_time", "time, s", { label: "NEES", y: log });
    drawCurve("nis", "nis_over_time", "time, s", { label: "NIS a component", y: log });
    drawCurve("intents", "intent_after_switch", "seconds after the switch", { label: "P(true intent)", event: true, y: share });
    drawCurve("surges", "surge_probability_after_surge", "seconds after the surge begins", { label: "P(surge)", event: true, y: share });
    drawCost();
    startPlayer();
  }
  function choose(index) {
    scene = index;
    data = JSON.parse(byId("scene-" + index).textContent);
    for (const part of document.querySelectorAll("[data-scene]")) part.hidden = Number(part.dataset.scene) !== index;
    drawAll();
  }

  function sortBy(button) {
    const head = button.closest("th"), table = head.closest("table"), column = [...head.parentNode.children].indexOf(head);
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentNode.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const value = (row) => { const cell = row.children[column], v = cell.dataset.v; return v === undefined ? cell.textContent.trim() : v; };
    const numeric = [...table.tBodies[0].rows].every((row) => { const v = value(row); return v === "" || !Number.isNaN(Number(v)); });
    const rows = [...table.tBodies[0].rows].sort((a, b) => {
      const x = value(a), y = value(b);
      if (x === "" || y === "") return x === y ? 0 : x === "" ? 1 : -1;
      const order = numeric ? Number(x) - Number(y) : x.localeCompare(y);
      return down ? -order : order;
    });
    table.tBodies[0].append(...rows);
  }
  async function copy(button) {
    const text = button.dataset.copy;
    try { await navigator.clipboard.writeText(text); }
    catch (refused) {
      const area = document.createElement("textarea");
      area.value = text; area.style.position = "fixed"; area.style.opacity = "0";
      document.body.append(area); area.select(); document.execCommand("copy"); area.remove();
    }
    const before = button.textContent;
    button.textContent = "Copied"; byId("said").textContent = "Command copied";
    setTimeout(() => { button.textContent = before; }, 1500);
  }

  document.addEventListener("click", (event) => {
    const button = event.target.closest("button");
    if (!button) return;
    if (button.dataset.copy) copy(button);
    else if (button.classList.contains("sort")) sortBy(button);
    else if (button.id === "theme") { root.setAttribute("data-theme", dark() ? "light" : "dark"); drawAll(); }
    else if (button.id === "play") togglePlayer();
  });
  if (byId("scene")) byId("scene").addEventListener("change", (event) => choose(Number(event.target.value)));
  if (byId("metric")) byId("metric").addEventListener("change", drawLadder);
  for (const id of ["who", "other"]) if (byId(id)) byId(id).addEventListener("change", drawPlayer);
  if (byId("time")) byId("time").addEventListener("input", (event) => { stopPlayer(); seek(Number(event.target.value)); });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  if (facts.scenes) choose(facts.first);
  root.setAttribute("data-ready", "true");
})();
