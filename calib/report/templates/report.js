"use strict";
// Tables sort by a click on a column's head; without this script they read the same, unsorted.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const key = (row, i) => {
    const cell = row.cells[i];
    return cell.dataset.key === undefined ? cell.textContent.trim() : Number(cell.dataset.key);
  };
  const compare = (a, b) => {
    if (typeof a === "number" && typeof b === "number") return a - b;
    if (typeof a === "number") return -1;
    if (typeof b === "number") return 1;
    return a.localeCompare(b, "en", { numeric: true });
  };
  table.querySelectorAll("thead th").forEach((head, i) => {
    if (head.textContent.trim() === "") return;
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    button.addEventListener("click", () => {
      const sign = head.ariaSort === "ascending" ? -1 : 1;
      for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
      head.ariaSort = sign > 0 ? "ascending" : "descending";
      const rows = Array.from(body.rows);
      rows.sort((a, b) => sign * compare(key(a, i), key(b, i)));
      body.append(...rows);
    });
    head.append(button);
  });
}

// Chapters fold. Links into them, printing and the button of the contents open them.
const folds = Array.from(document.querySelectorAll("main details"));
// In a narrow window the contents would push the verdict off the first screen.
if (innerWidth < 992) document.querySelector(".contents").open = false;
const reveal = () => {
  const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  if (!target) return;
  const inner = target.querySelector(":scope > details");
  if (inner) inner.open = true;
  for (let at = target; at; at = at.parentElement) if (at.tagName === "DETAILS") at.open = true;
  target.scrollIntoView();
};
addEventListener("hashchange", reveal);
reveal();
let closed = [];
addEventListener("beforeprint", () => {
  closed = folds.filter((fold) => !fold.open);
  for (const fold of closed) fold.open = true;
});
addEventListener("afterprint", () => {
  for (const fold of closed) fold.open = false;
});
const everything = document.createElement("button");
everything.type = "button";
everything.className = "everything";
everything.textContent = "Open all chapters";
everything.addEventListener("click", () => {
  const open = folds.some((fold) => !fold.open);
  for (const fold of folds) fold.open = open;
  everything.textContent = open ? "Close all chapters" : "Open all chapters";
});
const usage = document.createElement("p");
usage.className = "usage";
usage.textContent = "Point at a mark in a figure for its value, click to enlarge. By keyboard: Tab, \u2190 and \u2192, Enter.";
document.querySelector("nav").append(everything, usage);

// Every table as CSV, numbers with all their digits; a cue beside what is wider than the window.
const plain = (text) => text.replace(/\s+/g, " ").trim().replace(/\u2212/g, "-");
const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text);
const entry = (cell) => {
  const text = plain(cell.textContent).replace(/^[\u25b2\u2713] /, "");
  const single = /^[-+]?[\d.\u202f]+(e[-+]?\d+)?$/i.test(text) && cell.dataset.key !== undefined;
  return quoted(single ? cell.dataset.key : text === "\u2013" ? "" : text);
};
const csv = (table) =>
  Array.from(table.rows, (row) => Array.from(row.cells, entry).join(",")).join("\r\n") + "\r\n";
const named = (text) => plain(text).toLowerCase().replace(/[^a-z0-9]+/g, "-").replace(/^-|-$/g, "");
for (const box of document.querySelectorAll(".scroll")) {
  const tools = document.createElement("div");
  tools.className = "tools";
  const cue = document.createElement("span");
  cue.className = "cue";
  cue.textContent = "\u2192 scroll sideways for more";
  tools.append(cue);
  const table = box.querySelector("table");
  if (table) {
    const link = document.createElement("a");
    link.className = "data";
    link.textContent = "This table (CSV)";
    link.download = `${named(table.caption ? table.caption.textContent : "table")}.csv`;
    link.href = "#";
    link.addEventListener("click", () => {
      link.href = `data:text/csv;charset=utf-8,${encodeURIComponent(csv(table))}`;
    });
    tools.append(link);
  }
  box.after(tools);
  new ResizeObserver(() => {
    box.classList.toggle("cut", box.scrollWidth > box.clientWidth + 1);
  }).observe(box);
}

// Values under the pointer or by the arrow keys, and figures and pictures enlarged: wheel or +/- to
// zoom, drag or arrow keys to move.
const tip = document.createElement("div");
tip.className = "tip";
tip.hidden = true;
tip.setAttribute("role", "status");
const pointsOf = (image) => (image.dataset.points ? JSON.parse(image.dataset.points) : []);
// Where a picture is drawn: one that fits into a larger frame leaves room about it.
const drawn = (image) => {
  const frame = image.getBoundingClientRect();
  const natural = image.naturalWidth / image.naturalHeight;
  const width = Math.min(frame.width, frame.height * natural);
  const height = width / natural;
  return { left: frame.left + (frame.width - width) / 2, top: frame.top + (frame.height - height) / 2, width, height };
};
const tell = (text, x, y, where = document.body) => {
  tip.textContent = text;
  tip.hidden = false;
  where.append(tip);
  tip.style.left = `${Math.max(Math.min(x + 12, innerWidth - tip.offsetWidth - 4), 4)}px`;
  tip.style.top = `${Math.max(Math.min(y + 12, innerHeight - tip.offsetHeight - 4), 4)}px`;
};
// Step from mark to mark of a figure, from left to right; return whether the key was for that.
const stepper = (image, points) => {
  let place = -1;
  let order = null;
  return (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    const all = [...points];
    if (!by || !all.length) return false;
    if (order === null || order.length !== all.length) order = all.sort((a, b) => a[0] - b[0] || a[1] - b[1]);
    place = place < 0 && by < 0 ? order.length - 1 : (place + by + order.length) % order.length;
    const [x, y, text] = order[place];
    const box = drawn(image);
    event.preventDefault();
    tell(text, box.left + x * box.width, box.top + y * box.height, image.closest("dialog") || document.body);
    return true;
  };
};
const hover = (image, points) => {
  image.addEventListener("pointermove", (event) => {
    const box = drawn(image);
    let best = null;
    let least = 14;
    for (const [x, y, text] of points) {
      const away = Math.hypot(box.left + x * box.width - event.clientX, box.top + y * box.height - event.clientY);
      if (away < least) [least, best] = [away, text];
    }
    tip.hidden = best === null;
    if (best !== null) tell(best, event.clientX, event.clientY, image.closest("dialog") || document.body);
  });
  image.addEventListener("pointerleave", () => { tip.hidden = true; });
};
const dialog = document.createElement("dialog");
dialog.setAttribute("aria-label", "Enlarged figure");
const large = document.createElement("img");
const shut = document.createElement("button");
shut.type = "button";
shut.textContent = "Close";
shut.addEventListener("click", () => dialog.close());
const what = document.createElement("p");
const keysOf = document.createElement("small");
keysOf.textContent = "+ and \u2212 zoom, arrow keys step through the values or, once enlarged, move; Esc closes";
dialog.append(shut, what, keysOf);
document.body.append(dialog);
const view = { scale: 1, x: 0, y: 0 };
const place = () => {
  large.style.transform = `translate(${view.x}px, ${view.y}px) scale(${view.scale})`;
};
const zoom = (factor, x, y) => {
  const scale = Math.min(Math.max(view.scale * factor, 1), 40);
  const by = scale / view.scale;
  view.x = scale === 1 ? 0 : x - (x - view.x) * by;
  view.y = scale === 1 ? 0 : y - (y - view.y) * by;
  view.scale = scale;
  place();
};
const at = (event) => {
  const box = dialog.getBoundingClientRect();
  return [event.clientX - box.left - large.offsetLeft, event.clientY - box.top - large.offsetTop];
};
dialog.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(event.deltaY < 0 ? 1.25 : 0.8, ...at(event));
}, { passive: false });
dialog.addEventListener("keydown", (event) => {
  const middle = [large.clientWidth / 2, large.clientHeight / 2];
  if (event.key === "+") zoom(1.25, ...middle);
  if (event.key === "-") zoom(0.8, ...middle);
  const [x, y] = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] || [0, 0];
  if (view.scale === 1) step(event);
  else if (x || y) {
    event.preventDefault();
    view.x += 80 * x;
    view.y += 80 * y;
    place();
  }
});
dialog.addEventListener("close", () => { tip.hidden = true; });
large.addEventListener("pointerdown", (event) => {
  event.preventDefault();
  large.setPointerCapture(event.pointerId);
});
large.addEventListener("pointermove", (event) => {
  if (!large.hasPointerCapture(event.pointerId)) return;
  view.x += event.movementX;
  view.y += event.movementY;
  place();
});
let current = [];
hover(large, { *[Symbol.iterator]() { yield* current; } });
let step = () => false;
const enlarge = (image, words) => {
  Object.assign(view, { scale: 1, x: 0, y: 0 });
  place();
  current = pointsOf(image);
  step = stepper(large, current);
  tip.hidden = true;
  large.src = image.dataset.large || image.src;
  large.alt = image.alt;
  what.textContent = words;
  dialog.append(large);
  dialog.showModal();
};
for (const image of document.querySelectorAll("figure img")) {
  const points = pointsOf(image);
  const along = stepper(image, points);
  hover(image, points);
  const words = image.closest("li") ? image.closest("li").textContent : "";
  image.classList.add("zoom");
  image.tabIndex = 0;
  image.setAttribute("role", "button");
  image.addEventListener("click", () => enlarge(image, words));
  image.addEventListener("blur", () => { tip.hidden = true; });
  image.addEventListener("keydown", (event) => {
    if (along(event)) return;
    if (event.key === "Escape") tip.hidden = true;
    if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      enlarge(image, words);
    }
  });
}

// The rig in three dimensions: parallel projection, X right, Y down, Z away at first seen from above.
for (const canvas of document.querySelectorAll("canvas[data-scene]")) {
  const scene = JSON.parse(canvas.dataset.scene);
  const pen = canvas.getContext("2d");
  const { point, direction } = scene.axis;
  const every = [[0, 0, 0], point, ...scene.targets.map((t) => t.at), ...scene.ellipsoids.map((e) => e.at)];
  const spans = [0, 1, 2].map((i) => every.map((p) => p[i])).map((v) => [Math.min(...v), Math.max(...v)]);
  const centre = spans.map(([low, high]) => (low + high) / 2);
  const size = Math.max(...spans.map(([low, high]) => high - low), 1);
  const longest = Math.max(...scene.ellipsoids.map((e) => Math.hypot(...e.axes[0])), 1e-9);
  // So much larger that the longest half axis is a twelfth of the scene; 1, 2 or 5 times a power of ten.
  const wanted = Math.max(size / 12 / longest, 1);
  const power = 10 ** Math.floor(Math.log10(wanted));
  const enlarged = power * [5, 2, 1].find((step) => step * power <= wanted);
  const look = { turn: -0.5, tilt: 0.6, zoom: 1, times: enlarged };
  canvas.look = look;
  let seen = [];
  const project = (p) => {
    const [x, y, z] = p.map((v, i) => v - centre[i]);
    const [ct, st, cp, sp] = [Math.cos(look.turn), Math.sin(look.turn), Math.cos(look.tilt), Math.sin(look.tilt)];
    const [across, away] = [ct * x + st * z, -st * x + ct * z];
    const scale = (0.8 * Math.min(canvas.width, canvas.height) * look.zoom) / size;
    return [canvas.width / 2 + scale * across, canvas.height / 2 + scale * (cp * y - sp * away)];
  };
  // At first all of it is seen, with room for names.
  const reached = every.map(project).map(([x, y]) => [Math.abs(x - canvas.width / 2), Math.abs(y - canvas.height / 2)]);
  look.zoom = 0.44 * Math.min(...[canvas.width, canvas.height].map((side, i) => side / Math.max(...reached.map((r) => r[i]), 1)));
  const line = (points, colour, width = 1) => {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    points.map(project).forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
    pen.stroke();
  };
  const dot = (p, colour, radius, text = "") => {
    const [x, y] = project(p);
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fill();
    if (text) pen.fillText(text, x + 8, y - 6);
    return [x, y];
  };
  const sum = (p, ...more) => p.map((v, i) => more.reduce((total, [k, d]) => total + k * d[i], v));
  const draw = () => {
    const ink = getComputedStyle(document.body).color;
    pen.clearRect(0, 0, canvas.width, canvas.height);
    pen.font = "15px sans-serif";
    for (const { at } of scene.targets) {
      line([[0, 0, 0], at], "rgb(213 94 0 / .45)");
      line([point, at], "rgb(0 114 178 / .45)");
    }
    const reach = size / 5;
    line([sum(point, [-reach, direction]), sum(point, [reach, direction])], "#0072b2", 3);
    [["X", [1, 0, 0]], ["Y", [0, 1, 0]], ["Z", [0, 0, 1]]].forEach(([name, unit]) => {
      const end = sum([0, 0, 0], [size / 8, unit]);
      line([[0, 0, 0], end], ink, 1.5);
      const [x, y] = project(end);
      pen.fillStyle = ink;
      pen.fillText(name, x + 4, y + 4);
    });
    for (const { at, axes } of scene.ellipsoids) {
      for (const [a, b] of [[0, 1], [0, 2], [1, 2]]) {
        const ring = Array.from({ length: 49 }, (_, i) => (i * Math.PI) / 24);
        line(ring.map((w) => sum(at, [look.times * Math.cos(w), axes[a]], [look.times * Math.sin(w), axes[b]])), "#009e73", 1.2);
      }
    }
    seen = scene.targets.map((t) => [...dot(t.at, ink, 3.5), `${t.name}: X ${t.at[0].toFixed(1)}, Y ${t.at[1].toFixed(1)}, Z ${t.at[2].toFixed(1)} mm`]);
    dot([0, 0, 0], "#d55e00", 6, "C1");
    dot(point, "#0072b2", 6, "yaw axis");
    pen.fillStyle = ink;
    if (scene.ellipsoids.length) pen.fillText(`ellipsoids ×${look.times}`, 10, canvas.height - 12);
  };
  const zoomBy = (factor) => {
    look.zoom = Math.min(Math.max(look.zoom * factor, 0.3), 60);
    draw();
  };
  const turnBy = (x, y) => {
    look.turn += x;
    look.tilt = Math.min(Math.max(look.tilt + y, -1.57), 1.57);
    draw();
  };
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) turnBy(event.movementX / 150, event.movementY / 150);
    const box = canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) * (canvas.width / box.width), (event.clientY - box.top) * (canvas.height / box.height)];
    const near = seen.find(([px, py]) => Math.hypot(px - x, py - y) < 12);
    tip.hidden = !near;
    if (near) tell(near[2], event.clientX, event.clientY);
  });
  let named = -1;
  const name = (by) => {
    if (!seen.length) return;
    named = named < 0 && by < 0 ? seen.length - 1 : (named + by + seen.length) % seen.length;
    const [x, y, text] = seen[named];
    const box = canvas.getBoundingClientRect();
    tell(text, box.left + (x * box.width) / canvas.width, box.top + (y * box.height) / canvas.height);
  };
  canvas.addEventListener("blur", () => { tip.hidden = true; });
  canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    zoomBy(event.deltaY < 0 ? 1.15 : 0.87);
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turnBy(-0.1, 0), ArrowRight: () => turnBy(0.1, 0),
    ArrowUp: () => turnBy(0, -0.1), ArrowDown: () => turnBy(0, 0.1),
    "+": () => zoomBy(1.15), "-": () => zoomBy(0.87),
    m: () => { look.times = look.times === 1 ? enlarged : 1; draw(); },
  };
  keys.n = () => name(1);
  keys.p = () => name(-1);
  for (const key of "mnp") keys[key.toUpperCase()] = keys[key];
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  draw();
}
