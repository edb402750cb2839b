// The rig from above: X to the right, Z upwards, in mm of C1's frame.
const WIDTH = 640, HEIGHT = 480, MARGIN = 34;
const NS = "http://www.w3.org/2000/svg";

export function drawScene(svg, state) {
  const scene = state.scene;
  if (!scene) { svg.replaceChildren(); return "drawn when lenses and baseline are known"; }
  const key = JSON.stringify([scene, state.heading, state.measurements, state.lengths]);
  if (svg.dataset.key === key) return svg.dataset.text;
  svg.dataset.key = key;
  const found = (state.measurements || []).filter((one) => one.xyz_mm).slice(-30);
  const view = fit(scene, found);
  const parts = [...grid(view), ...cameras(scene, state.heading, view)];
  const last = found[found.length - 1];
  if (last) parts.push(...rays(scene, last, view));
  const scale = magnification(found, view);
  found.forEach((one) => parts.push(...target(one, scale, view, one === last)));
  (state.lengths || []).filter((one) => one.ends_mm).slice(-1).forEach((one) => parts.push(gauge(one, view)));
  const clip = make("clipPath", { id: "inside" });
  clip.append(make("rect", { x: 0, y: view.y(view.far), width: WIDTH, height: HEIGHT }));
  svg.replaceChildren(clip, ...parts);
  svg.dataset.text = found.length
    ? `95 % ellipses of x and z, drawn ${scale} times as large; the last ${found.length} targets`
    : "fields of view; grid in mm";
  svg.setAttribute("aria-label", `The rig from above with ${found.length} targets`);
  return svg.dataset.text;
}

function make(name, attributes, text) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
}

function fit(scene, found) {
  const far = Math.max(scene.depths_mm[1], ...found.map((one) => one.xyz_mm[2])) * 1.08;
  const xs = [0, scene.axis_mm[0], ...found.map((one) => one.xyz_mm[0]), ...scene.field_c1.map((s) => s * far)];
  const left = Math.min(...xs), right = Math.max(...xs);
  const scale = Math.min((WIDTH - 2 * MARGIN) / (right - left), (HEIGHT - 2 * MARGIN) / far);
  const middle = (left + right) / 2;
  return {
    far, left, right, scale,
    x: (x) => WIDTH / 2 + (x - middle) * scale,
    y: (z) => HEIGHT - MARGIN - z * scale,
  };
}

function grid(view) {
  const step = [50, 100, 200, 250, 500, 1000, 2000, 5000].find((s) => view.far / s <= 7) || 10000;
  const parts = [];
  for (let z = 0; z <= view.far; z += step) {
    parts.push(make("line", { class: "grid", x1: MARGIN, x2: WIDTH - MARGIN, y1: view.y(z), y2: view.y(z) }));
    parts.push(make("text", { x: WIDTH - MARGIN, y: view.y(z) - 4, "text-anchor": "end" }, `${z} mm`));
  }
  return parts;
}

function wedge(view, kind, from, rays) {
  const points = [from, ...rays].map(([x, z]) => `${view.x(x).toFixed(1)},${view.y(z).toFixed(1)}`);
  return make("polygon", { class: `field ${kind}`, points: points.join(" "), "clip-path": "url(#inside)" });
}

function cameras(scene, heading, view) {
  const far = view.far;
  const parts = [wedge(view, "c1", [0, 0], scene.field_c1.map((s) => [s * far, far]))];
  const [ax, az] = scene.axis_mm;
  if (heading) {
    const [gx, gz] = heading;
    // A slope s of C2's picture is a turn by atan(s), to the right seen from behind.
    const long = 3 * far; // as far as the edge of the drawing, whichever way C2 looks
    const ends = scene.field_c2.map((s) => [ax + long * (gx + s * gz), az + long * (gz - s * gx)]);
    parts.push(wedge(view, "c2", [ax, az], ends));
    parts.push(make("line", { class: "ray c2", x1: view.x(ax), y1: view.y(az),
      x2: view.x(ax + far * gx), y2: view.y(az + far * gz) }));
  }
  parts.push(make("circle", { class: "camera c1", cx: view.x(0), cy: view.y(0), r: 5 }));
  parts.push(make("circle", { class: "camera c2", cx: view.x(ax), cy: view.y(az), r: 5 }));
  const right = ax >= 0;
  parts.push(make("text", { class: "strong", x: view.x(0), y: view.y(0) + 20, "text-anchor": right ? "end" : "start" }, "C1"));
  parts.push(make("text", { class: "strong", x: view.x(ax), y: view.y(az) + 20, "text-anchor": right ? "start" : "end" }, "C2"));
  return parts;
}

function rays(scene, one, view) {
  const [x, , z] = one.xyz_mm;
  const [ax, az] = scene.axis_mm;
  const ray = (kind, fx, fz) => make("line", { class: `ray ${kind}`,
    x1: view.x(fx), y1: view.y(fz), x2: view.x(x), y2: view.y(z) });
  return [ray("c1", 0, 0), ray("c2", ax, az)];
}

// Real ellipses are fractions of a pixel: all are enlarged alike, by a round number that is stated.
function magnification(found, view) {
  const longest = Math.max(0, ...found.map((one) => one.ellipse.long_mm)) * view.scale;
  const wanted = longest ? 26 / longest : 1;
  const rounds = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
  return rounds.filter((r) => r <= wanted).pop() || 1;
}

function target(one, scale, view, isLast) {
  const [x, , z] = one.xyz_mm;
  const cx = view.x(x), cy = view.y(z);
  const { long_mm: long, short_mm: short, angle_rad: angle } = one.ellipse;
  const ellipse = make("ellipse", { class: "ellipse", cx, cy,
    rx: Math.max(1, long * scale * view.scale), ry: Math.max(1, short * scale * view.scale),
    transform: `rotate(${(-angle * 180 / Math.PI).toFixed(2)} ${cx} ${cy})` });
  ellipse.append(make("title", {}, `${one.id}: z ${one.xyz_mm[2].toFixed(2)} mm`));
  const parts = [ellipse, make("circle", { class: "point", cx, cy, r: isLast ? 3.5 : 2 })];
  if (isLast) parts.push(make("text", { class: "strong", x: cx + 12, y: cy - 8 }, one.id));
  return parts;
}

function gauge(one, view) {
  const [[x1, , z1], [x2, , z2]] = one.ends_mm;
  return make("line", { class: "gauge", x1: view.x(x1), y1: view.y(z1), x2: view.x(x2), y2: view.y(z2) });
}
