"use strict";
// Figures answer: the mouse tells values and draws a frame to zoom into; with the keyboard, arrow keys read, + and - zoom.
for (const panel of document.querySelectorAll(".panel")) {
  const {x, y, equal, series, maps} = JSON.parse(panel.dataset.panel);
  const chart = panel.querySelector(".chart"), plot = chart.querySelector(".plot");
  const ticks = chart.querySelector(".ticks"), cursor = chart.querySelector(".cursor"), first = ticks.innerHTML;
  const [left, top, wide, high] = ["x", "y", "width", "height"].map((name) => plot[name].baseVal.value);
  const said = document.createElement("output"), tools = document.createElement("div");
  // Shares of the axes from the lower left that are shown, and the place that is told.
  let shown = {x: [0, 1], y: [0, 1]}, at = null, start = null;

  const share = (axis, value) => axis.log
    ? Math.log(value / axis.ends[0]) / Math.log(axis.ends[1] / axis.ends[0])
    : (value - axis.ends[0]) / (axis.ends[1] - axis.ends[0]);
  const value = (axis, part) => axis.log
    ? axis.ends[0] * (axis.ends[1] / axis.ends[0]) ** part
    : axis.ends[0] + part * (axis.ends[1] - axis.ends[0]);
  const view = (name, part) => (part - shown[name][0]) / (shown[name][1] - shown[name][0]);
  const number = (given) => given === null ? "–" : String(Number(given.toPrecision(4)));
  const named = (axis, given) => {
    const name = axis.names.find(([place]) => place === given);
    return name ? name[1].replace("\n", ", ") : number(given);
  };

  for (const map of maps) {
    const bytes = Uint8Array.from(atob(map.values), (sign) => sign.charCodeAt(0));
    map.steps = new Uint16Array(bytes.buffer);
  }
  const points = series.flatMap((each) => each.kind !== "points" ? [] : each.x.map((_, k) => ({each, k})))
    .filter(({each, k}) => each.x[k] !== null && each.y[k] !== null).sort((a, b) => a.each.x[a.k] - b.each.x[b.k]);
  const curves = series.filter((each) => each.kind !== "points");
  const places = [...new Set(curves.flatMap((each) => each.x))].filter((each) => each !== null).sort((a, b) => a - b);

  function mapped(map, across, up) {
    const [rows, columns] = map.shape;
    const column = Math.floor((across - map.left) / (map.right - map.left) * columns);
    const row = Math.floor((up - map.low) / (map.high - map.low) * rows);
    if (column < 0 || row < 0 || column >= columns || row >= rows) return "";
    const step = map.steps[row * columns + column];
    return step === 65535 ? "none" : `${number(step / 65534 * map.top)} ${map.unit}`.trim();
  }
  function limits(each, k, share = 0) {
    if (!each.low) return "";
    const [low, up] = [each.low, each.high].map((limit) =>
      limit[k] === null ? null : limit[k] + share * ((limit[k + 1] ?? limit[k]) - limit[k]));
    return low === null || up === null ? "" : ` (${number(low)} to ${number(up)})`;
  }
  function along(each, across) {
    const {x: xs, y: ys} = each, last = xs.length - 1;
    if (across < xs[0] || across > xs[last]) return null;
    let k = xs.findLastIndex((known) => known <= across);
    if (each.kind === "step" || k === last) return {up: ys[k], said: number(ys[k]) + limits(each, k)};
    const part = (across - xs[k]) / (xs[k + 1] - xs[k]), up = ys[k] + part * (ys[k + 1] - ys[k]);
    return ys[k] === null || ys[k + 1] === null ? {up: null, said: "–"} : {up, said: number(up) + limits(each, k, part)};
  }

  // What is told at a place, in data; dots mark it.
  function read(across, up, point) {
    const dots = [];
    let words = `${x.label}: ${named(x, across)}`;
    if (point) {
      const {each, k} = point;
      dots.push([across, up]);
      words += `; ${y.label}: ${named(y, up)}${limits(each, k)}` + (each.name ? `; ${each.name}` : "");
    } else if (curves.length) {
      for (const each of curves) {
        const found = along(each, across);
        if (!found) continue;
        words += `; ${curves.length > 1 || !y.label ? each.name : y.label}: ${found.said}`;
        if (found.up !== null) dots.push([across, found.up]);
      }
    } else {
      words += `; ${y.label}: ${number(up)}`;
      for (const map of maps) words += `; ${mapped(map, across, up)}`;
      dots.push([across, up]);
    }
    return {words, dots};
  }
  function tell(across, up, point, quiet) {
    at = {across, up, point};
    const {words, dots} = read(across, up, point);
    const far = view("x", share(x, across)) * wide;
    cursor.innerHTML = `<path d="M${far} 0v${high}"/>` + dots.map(([a, b]) =>
      `<circle r="4" cx="${view("x", share(x, a)) * wide}" cy="${(1 - view("y", share(y, b))) * high}"/>`).join("");
    said.textContent = words;
    if (!quiet && panel.parentElement.hasAttribute("data-linked"))
      panel.parentElement.dispatchEvent(new CustomEvent("told", {detail: {panel, across, up}}));
  }
  panel.parentElement.addEventListener("told", ({detail}) => {
    if (detail.panel !== panel) tell(detail.across, detail.up, null, true);
  });
  function forget() { at = null; cursor.innerHTML = ""; said.textContent = ""; }

  function nice(axis, [from, to]) {
    const [low, up] = [value(axis, from), value(axis, to)];
    if (axis.names.length) return axis.names.filter(([place]) => place >= low && place <= up);
    if (axis.log && up / low > 30) {
      const powers = Array.from({length: 40}, (_, k) => 10 ** (k - 20));
      return powers.filter((power) => power >= low && power <= up).map((power) => [power, number(power)]);
    }
    const rough = (up - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].find((each) => each * power >= rough) * power, found = [];
    for (let k = Math.ceil(low / step); k * step <= up; k++) found.push([k * step, number(k * step)]);
    return found;
  }
  function draw() {
    const [sx, sy] = [shown.x, shown.y].map(([from, to]) => 1 / (to - from));
    const [tx, ty] = [-shown.x[0] * sx * wide, (shown.y[1] - 1) * sy * high];
    chart.querySelector(".zoomed").setAttribute("transform", `matrix(${sx} 0 0 ${sy} ${tx} ${ty})`);
    for (const mark of chart.querySelectorAll("[data-at]")) {
      const [a, b] = mark.dataset.at.split(" ").map(Number);
      mark.setAttribute("transform", `translate(${a * sx + tx} ${b * sy + ty})`);
    }
    const all = shown.x[0] === 0 && shown.x[1] === 1 && shown.y[0] === 0 && shown.y[1] === 1;
    if (all) ticks.innerHTML = first;
    else {
      ticks.replaceChildren();
      const add = (name, given, text) => {
        const made = document.createElementNS("http://www.w3.org/2000/svg", name);
        for (const [key, each] of Object.entries(given)) made.setAttribute(key, each);
        if (text) made.textContent = text;
        ticks.append(made);
      };
      for (const [place, name] of nice(x, shown.x)) {
        const far = left + view("x", share(x, place)) * wide;
        add("path", {d: `M${far} ${top + high}v4`});
        name.split("\n").forEach((line, k) =>
          add("text", {x: far, y: top + high + 17 + 13 * k, "text-anchor": "middle"}, line));
      }
      for (const [place, name] of nice(y, shown.y)) {
        const far = top + (1 - view("y", share(y, place))) * high;
        add("path", {d: `M${left} ${far}h-4`});
        add("text", {x: left - 7, y: far + 4, "text-anchor": "end"}, name);
      }
    }
    panel.classList.toggle("near", !all);
    if (at) tell(at.across, at.up, at.point, true);
  }
  function within([from, to]) {
    const size = Math.min(to - from, 1), low = Math.min(Math.max(from, 0), 1 - size);
    return [low, low + size];
  }
  function zoom(factor) {
    const size = Math.max((shown.x[1] - shown.x[0]) * factor, 0.002);
    const middle = (name, axis, given) => at && given !== null ? share(axis, given)
      : (shown[name][0] + shown[name][1]) / 2;
    const [cx, cy] = [middle("x", x, at && at.across), middle("y", y, at && at.up)];
    const tall = (shown.y[1] - shown.y[0]) * factor;
    shown = {x: within([cx - size / 2, cx + size / 2]), y: within([cy - tall / 2, cy + tall / 2])};
    draw();
  }
  function whole() { shown = {x: [0, 1], y: [0, 1]}; draw(); }
  function follow() {
    for (const [name, axis, given] of [["x", x, at.across], ["y", y, at.up]]) {
      if (given === null) continue;
      const size = shown[name][1] - shown[name][0], part = share(axis, given);
      if (part < shown[name][0] || part > shown[name][1]) shown[name] = within([part - size / 2, part + size / 2]);
    }
    draw();
  }

  // The place under the mouse, as shares of what is shown.
  function under(event) {
    const corner = new DOMPoint(event.clientX, event.clientY).matrixTransform(cursor.getScreenCTM().inverse());
    return [corner.x, corner.y];
  }
  function point(event) {
    const [px, py] = under(event);
    const across = value(x, shown.x[0] + px / wide * (shown.x[1] - shown.x[0]));
    const up = value(y, shown.y[0] + (1 - py / high) * (shown.y[1] - shown.y[0]));
    if (!points.length) return tell(across, curves.length ? null : up);
    const distance = ({each, k}) => Math.hypot(view("x", share(x, each.x[k])) * wide - px,
      (1 - view("y", share(y, each.y[k]))) * high - py);
    const near = points.reduce((best, each) => distance(each) < distance(best) ? each : best);
    tell(near.each.x[near.k], near.each.y[near.k], near);
  }
  function step(by, upwards) {
    if (curves.length && !points.length) {
      const k = at ? places.findLastIndex((place) => place <= at.across) : by > 0 ? -1 : places.length;
      tell(places[Math.min(Math.max(k + by, 0), places.length - 1)], null);
    } else if (points.length) {
      const k = at ? points.indexOf(at.point) : by > 0 ? -1 : points.length;
      const next = points[Math.min(Math.max(k + by, 0), points.length - 1)];
      tell(next.each.x[next.k], next.each.y[next.k], next);
    } else {
      // Maps go by their columns, pictures by a hundredth of their length.
      const map = maps[0], [low, up] = x.ends;
      const size = map ? (map.right - map.left) / map.shape[1] : (up - low) / 100;
      const from = at || (map ? {across: map.left + size / 2, up: map.low + (map.high - map.low) / map.shape[0] / 2}
        : {across: (low + up) / 2, up: (y.ends[0] + y.ends[1]) / 2});
      const tall = map ? (map.high - map.low) / map.shape[0] : size;
      const clip = (given, [a, b]) => Math.min(Math.max(given, a), b);
      tell(at && !upwards ? clip(from.across + by * size, x.ends) : from.across,
        at && upwards ? clip(from.up + by * tall, y.ends) : from.up);
    }
    follow();
  }
  const keys = {
    ArrowRight: (far) => step(far), ArrowLeft: (far) => step(-far),
    ArrowUp: (far) => step(far, true), ArrowDown: (far) => step(-far, true),
    Home: () => step(-1e6), End: () => step(1e6),
    "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), 0: whole, Escape: () => { forget(); whole(); },
  };
  chart.addEventListener("keydown", (event) => {
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act(event.shiftKey ? 10 : 1);
  });

  chart.addEventListener("pointermove", (event) => {
    if (event.pointerType === "touch") return;
    point(event);
    if (!start) return;
    const [px, py] = under(event), [a, b] = [Math.min(px, start[0]), Math.min(py, start[1])];
    cursor.innerHTML = `<rect x="${a}" y="${b}" width="${Math.abs(px - start[0])}" height="${Math.abs(py - start[1])}"/>`;
  });
  chart.addEventListener("pointerdown", (event) => {
    if (event.pointerType === "touch" || event.button) return;
    start = under(event);
    chart.setPointerCapture(event.pointerId);
  });
  chart.addEventListener("pointerup", (event) => {
    if (!start) return;
    const end = under(event), [px, py] = start;
    start = null;
    if (Math.hypot(end[0] - px, end[1] - py) < 6) return point(event);
    const part = (name, from, to, size, turned) => {
      const ends = [from, to].map((each) => turned ? 1 - each / size : each / size).sort((a, b) => a - b);
      return ends.map((each) => shown[name][0] + each * (shown[name][1] - shown[name][0]));
    };
    let [nx, ny] = [part("x", px, end[0], wide), part("y", py, end[1], high, true)];
    const size = Math.max(nx[1] - nx[0], ny[1] - ny[0], 0.002);
    const grown = ([from, to], given) => [(from + to - given) / 2, (from + to + given) / 2];
    if (equal) [nx, ny] = [grown(nx, size), grown(ny, size)];
    else [nx, ny] = [nx, ny].map((each) => grown(each, Math.max(each[1] - each[0], 0.002)));
    shown = {x: within(nx), y: within(ny)};
    draw();
  });
  chart.addEventListener("pointerleave", () => { if (document.activeElement !== chart) forget(); });
  chart.addEventListener("click", (event) => { if (event.pointerType === "touch") point(event); });
  chart.addEventListener("dblclick", whole);

  said.className = "said";
  tools.className = "tools";
  for (const [sign, title, act] of [["+", "nearer", () => zoom(0.5)], ["−", "farther", () => zoom(2)], ["0", "all", whole]]) {
    const button = document.createElement("button");
    Object.assign(button, {type: "button", textContent: sign, title, tabIndex: -1});
    button.setAttribute("aria-label", `${title}: ${panel.querySelector(".title")?.textContent ?? y.label}`);
    button.addEventListener("click", act);
    tools.append(button);
  }
  chart.tabIndex = 0;
  chart.setAttribute("aria-roledescription", "figure; arrow keys read its values, plus and minus zoom, 0 shows all");
  chart.after(said);
  panel.prepend(tools);
}
