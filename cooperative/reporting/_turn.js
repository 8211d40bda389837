// Draws the bodies of every <figure class="turn"> on its canvas, turned as the reader drags. Parallel projection: faces
// and pieces of lines are painted from the farthest to the nearest, names over them.
"use strict";
(() => {
  const unpack = async (text) => {
    const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Response(stream).arrayBuffer();
  };

  // Four corners and a colour of every face, with its middle and the normal that points out of the body.
  const read = (body, buffer) => {
    const count = body.faces, corners = new Float32Array(buffer, 0, 12 * count);
    const bytes = new Uint8Array(buffer, 48 * count, 4 * count);
    const faces = { count, corners, middles: new Float32Array(3 * count), normals: new Float32Array(3 * count) };
    faces.colours = Array.from({ length: count }, (_, f) => {
      const at = (k, axis) => corners[12 * f + 3 * k + axis];
      const [a, b] = [[0, 1, 2], [0, 1, 2]].map((axes, k) => axes.map((axis) => at(2 + k, axis) - at(k, axis)));
      const n = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
      const size = Math.hypot(...n) || 1;
      for (let axis = 0; axis < 3; axis++) {
        faces.normals[3 * f + axis] = n[axis] / size;
        faces.middles[3 * f + axis] = (at(0, axis) + at(1, axis) + at(2, axis) + at(3, axis)) / 4;
      }
      // The light stands in the sky, to the left and in front.
      const light = 0.72 + 0.28 * (n[2] * 0.8 - n[0] * 0.35 - n[1] * 0.5) / size;
      const [r, g, b8, alpha] = bytes.subarray(4 * f, 4 * f + 4);
      return `rgba(${[r, g, b8].map((v) => Math.round(v * light)).join()},${alpha / 255})`;
    });
    faces.solid = Array.from({ length: count }, (_, f) => bytes[4 * f + 3] === 255);
    return faces;
  };

  // Pieces of lines, short enough for each to lie before or behind a face; a dashed line has every other one.
  const pieces = (lines, longest) =>
    lines.flatMap(({ points, colour, dashed }) =>
      points.slice(1).flatMap((end, k) => {
        const begin = points[k], count = Math.ceil(Math.hypot(...end.map((v, axis) => v - begin[axis])) / longest) || 1;
        const at = (n) => begin.map((v, axis) => v + ((end[axis] - v) * n) / count);
        return Array.from({ length: count }, (_, n) => ({ ends: [at(n), at(n + 1)], middle: at(n + 0.5), colour }))
          .filter((_, n) => !dashed || n % 2 === 0);
      }));

  const nice = (most) => {
    const ten = 10 ** Math.floor(Math.log10(most));
    return ten * [5, 2, 1].find((k) => k * ten <= most);
  };

  const start = async (figure) => {
    const canvas = figure.querySelector("canvas"), pen = canvas.getContext("2d");
    const said = JSON.parse(figure.querySelector("script").textContent);
    const bodies = [];
    const look = { turn: -0.9, tilt: 0.55, zoom: 1, body: 0 };
    const [low, high] = said.ends, middle = low.map((v, k) => (v + high[k]) / 2);
    const reach = Math.hypot(...low.map((v, k) => high[k] - v)) / 2;

    const draw = () => {
      const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, tall = canvas.clientHeight;
      canvas.width = wide * ratio;
      canvas.height = tall * ratio;
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      const { lines } = said.bodies[look.body], { faces, edges } = bodies[look.body];
      const [ct, st, cu, su] = [Math.cos(look.turn), Math.sin(look.turn), Math.cos(look.tilt), Math.sin(look.tilt)];
      const right = [ct, -st, 0], up = [st * su, ct * su, cu], towards = [-st * cu, -ct * cu, su];
      const along = (axis, v, at) =>
        axis[0] * (v[at] - middle[0]) + axis[1] * (v[at + 1] - middle[1]) + axis[2] * (v[at + 2] - middle[2]);
      const scale = look.zoom * 0.5 * Math.min(wide, 1.2 * tall) / reach;
      const place = (v, at) => [wide / 2 + scale * along(right, v, at), tall / 2 - scale * along(up, v, at)];
      const facing = (f) =>
        faces.normals[3 * f] * towards[0] + faces.normals[3 * f + 1] * towards[1] + faces.normals[3 * f + 2] * towards[2];
      const seen = [...faces.solid.keys()].filter((f) => !faces.solid[f] || facing(f) > 0);
      const depth = seen.map((f) => along(towards, faces.middles, 3 * f));
      // A line on a face lies before it.
      const nearer = 0.03 * reach;
      for (const edge of edges) depth.push(along(towards, edge.middle, 0) + nearer);
      pen.lineJoin = "round";
      for (const item of [...depth.keys()].sort((a, b) => depth[a] - depth[b])) {
        pen.beginPath();
        if (item >= seen.length) {
          const edge = edges[item - seen.length];
          for (const end of edge.ends) pen.lineTo(...place(end, 0));
          pen.lineWidth = 2;
          pen.strokeStyle = edge.colour;
          pen.stroke();
          continue;
        }
        const f = seen[item];
        for (let k = 0; k < 4; k++) pen.lineTo(...place(faces.corners, 12 * f + 3 * k));
        pen.closePath();
        pen.fillStyle = pen.strokeStyle = faces.colours[f];
        pen.fill();
        pen.lineWidth = 0.6;
        // Without its edge a face lets its neighbour's background through.
        if (faces.solid[f]) pen.stroke();
      }
      pen.font = "13px system-ui, sans-serif";
      for (const line of lines) {
        const [x, y] = place(line.points[0], 0);
        pen.fillStyle = line.colour;
        if (line.points.length === 1) {
          pen.beginPath();
          pen.arc(x, y, 4, 0, 7);
          pen.fill();
        }
        if (!line.name) continue;
        const left = Math.min(x + 6, wide - pen.measureText(line.name).width - 4);
        pen.lineWidth = 3;
        pen.strokeStyle = "#fff";
        pen.strokeText(line.name, left, y - 6);
        pen.fillText(line.name, left, y - 6);
      }
      pen.strokeStyle = pen.fillStyle = "#333";
      pen.lineWidth = 1.5;
      const metres = nice(wide / 4 / scale), y = tall - 12;
      pen.beginPath();
      pen.moveTo(12, y - 4);
      pen.lineTo(12, y);
      pen.lineTo(12 + metres * scale, y);
      pen.lineTo(12 + metres * scale, y - 4);
      pen.stroke();
      pen.fillText(`${metres} m`, 16, y - 5);
      for (const [name, k] of [["x", 0], ["y", 1], ["z", 2]]) {
        const [dx, dy] = [30 * right[k], -30 * up[k]];
        pen.beginPath();
        pen.moveTo(wide - 50, tall - 40);
        pen.lineTo(wide - 50 + dx, tall - 40 + dy);
        pen.stroke();
        pen.fillText(name, wide - 53 + 1.3 * dx, tall - 36 + 1.3 * dy);
      }
    };

    let due = false;
    const again = () => {
      if (due || !bodies[look.body]) return;
      due = true;
      requestAnimationFrame(() => {
        due = false;
        draw();
      });
    };
    const turn = (dx, dy) => {
      look.turn += dx;
      look.tilt = Math.min(Math.PI / 2, Math.max(0, look.tilt + dy));
      again();
    };
    const zoom = (factor) => {
      look.zoom = Math.min(20, Math.max(0.5, look.zoom * factor));
      again();
    };
    const show = async (number) => {
      const body = said.bodies[number];
      bodies[number] ??= { faces: read(body, await unpack(body.data)), edges: pieces(body.lines, reach / 50) };
      look.body = number;
      figure.querySelectorAll(".key").forEach((key, k) => (key.hidden = k !== number));
      again();
    };

    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) turn(event.movementX / 150, event.movementY / 150);
    });
    // A page that is scrolled past the picture must go on scrolling.
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas) return;
      event.preventDefault();
      zoom(event.deltaY < 0 ? 1.1 : 1 / 1.1);
    }, { passive: false });
    const keys = {
      ArrowLeft: () => turn(-0.1, 0), ArrowRight: () => turn(0.1, 0), ArrowUp: () => turn(0, -0.1),
      ArrowDown: () => turn(0, 0.1), "+": () => zoom(1.2), "-": () => zoom(1 / 1.2),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    figure.querySelectorAll("input").forEach((input, k) => input.addEventListener("change", () => show(k)));
    new ResizeObserver(again).observe(canvas);
    await show(0);
  };

  document.querySelectorAll("figure.turn").forEach(start);
})();
