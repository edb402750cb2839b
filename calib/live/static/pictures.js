// A picture with its marks: centre column, target.
const frames = { c1: 0, c2: 0 };
const drawn = { c1: NaN, c2: NaN };
const STALE_MS = 3000;
let outline = null; // what a guide asks for, drawn until it asks for something else

export function ask(asked) { outline = asked; }

export async function draw(data, $) {
  const view = new DataView(data);
  const length = view.getUint32(0);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  const came = performance.now();
  const bitmap = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" }));
  const canvas = $(head.camera);
  const [width, height] = head.size;
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  const pen = canvas.getContext("2d");
  pen.drawImage(bitmap, 0, 0);
  bitmap.close();
  const unit = width / 640;
  if (head.centre !== null) column(pen, head.centre, height, unit);
  const wanted = outline && outline.camera === head.camera ? outline : null;
  if (wanted) fillIn(pen, wanted, unit);
  else if (head.target) {
    dots(pen, head.marks, unit);
    mark(pen, head.target, unit);
  }
  canvas.dataset.outline = wanted ? "yes" : "";
  frames[head.camera] += 1;
  canvas.dataset.frames = frames[head.camera];
  const age = head.age_ms + performance.now() - came;
  canvas.dataset.age = age.toFixed(1);
  canvas.dataset.marks = head.marks.length;
  canvas.dataset.target = head.target ? head.target.join(" ") : "";
  const seen = head.target ? `target at ${head.target[0].toFixed(1)}, ${head.target[1].toFixed(1)} px` : "target not seen";
  $(`${head.camera}-text`).textContent = `${seen} · ${age.toFixed(0)} ms old`;
  canvas.setAttribute("aria-label", `Picture of ${head.camera.toUpperCase()}: ${seen}`);
  canvas.classList.remove("stale");
  drawn[head.camera] = performance.now();
  return head.camera;
}

// A picture that stands still must not look like one that is new.
export function ageOf(camera, fault, $) {
  const old = performance.now() - drawn[camera];
  if (!(old > STALE_MS) && !fault) return;
  $(camera).classList.toggle("stale", old > STALE_MS);
  const since = frames[camera] ? `no new picture for ${(old / 1000).toFixed(0)} s` : "no picture yet";
  if (fault || frames[camera]) $(`${camera}-text`).textContent = fault ? `${since}: ${fault}` : since;
}

function column(pen, u, height, unit) {
  pen.lineWidth = 1.5 * unit;
  pen.setLineDash([9 * unit, 7 * unit]);
  pen.strokeStyle = "#21d07a";
  pen.beginPath();
  pen.moveTo(u, 0);
  pen.lineTo(u, height);
  pen.stroke();
  pen.setLineDash([]);
}

function fillIn(pen, { outline: points, first, taken }, unit) {
  // Where boards were: the more of them, the denser.
  pen.fillStyle = "rgba(33,208,122,.10)";
  pen.strokeStyle = "rgba(33,208,122,.6)";
  pen.lineWidth = unit;
  for (const quad of taken) {
    pen.beginPath();
    quad.forEach(([u, v], i) => (i ? pen.lineTo(u, v) : pen.moveTo(u, v)));
    pen.closePath();
    pen.fill();
    pen.stroke();
  }
  const way = new Path2D();
  points.forEach(([u, v], i) => (i ? way.lineTo(u, v) : way.moveTo(u, v)));
  way.closePath();
  const start = new Path2D();
  start.arc(first[0], first[1], 7 * unit, 0, 2 * Math.PI);
  pen.fillStyle = "rgba(224,0,127,.14)";
  pen.fill(way);
  for (const [width, colour] of [[6, "rgba(255,255,255,.85)"], [3, "#e0007f"]]) {
    pen.lineWidth = width * unit;
    pen.strokeStyle = colour;
    pen.stroke(way);
    pen.stroke(start);
  }
}

// The points by which the target was found.
function dots(pen, points, unit) {
  pen.fillStyle = "rgba(224,0,127,.85)";
  for (const [u, v] of points) {
    pen.beginPath();
    pen.arc(u, v, 2 * unit, 0, 2 * Math.PI);
    pen.fill();
  }
}

function mark(pen, [u, v], unit) {
  const cross = () => {
    pen.beginPath();
    pen.arc(u, v, 15 * unit, 0, 2 * Math.PI);
    for (const [x, y] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      pen.moveTo(u + 8 * unit * x, v + 8 * unit * y);
      pen.lineTo(u + 24 * unit * x, v + 24 * unit * y);
    }
    pen.stroke();
  };
  pen.lineWidth = 5 * unit;
  pen.strokeStyle = "rgba(255,255,255,.85)";
  cross();
  pen.lineWidth = 2.2 * unit;
  pen.strokeStyle = "#e0007f";
  cross();
}
