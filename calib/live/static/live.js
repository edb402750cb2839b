// The page: one connection, the state that comes over it, and what the buttons ask for.
import { ageOf, ask, draw } from "./pictures.js";
import { drawScene } from "./scene.js";
import { fillLengths, fillPositions } from "./tables.js";

const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token") || "";
const query = token ? `?token=${encodeURIComponent(token)}` : "";
let fileQuery = query; // a page of this machine needs none, and the report none of its business
const CAMERAS = ["c1", "c2"];
const ONCE = ["check", "pictures", "capture", "calibrate"];
const AGAIN_MS = 1000;
const AGAIN_PICTURE_MS = 2000;

let socket = null;
let shownDocument = "";
let last = null; // the state that came last, with what it says of this page
let pickFor = "target"; // the field that a click on a picture fills
const faults = { c1: "", c2: "" };

function send(command) {
  if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(command));
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/ws${query}`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { notice(""); CAMERAS.forEach(askPicture); };
  socket.onmessage = (event) => {
    if (typeof event.data === "string") heard(JSON.parse(event.data));
    else draw(event.data, $).then(askPicture);
  };
  socket.onclose = () => {
    pill("not connected", "lost");
    enable(null, { may_command: false });
    setTimeout(connect, AGAIN_MS);
  };
}

// The next picture is asked for when the last is drawn: a slow page gets fewer, never older ones.
function askPicture(camera) {
  if (document.hidden) { setTimeout(() => askPicture(camera), 500); return; }
  send({ do: "picture", camera });
}

function heard(message) {
  if (message.notice) {
    notice(message.notice);
    if (last) enable(last.state, last.page);
    return;
  }
  if (message.picked) {
    $(pickFor).value = message.picked;
    return;
  }
  last = message;
  const { state, page } = message;
  $("serial").textContent = state.rig ? state.rig.serial : "";
  $("reading").textContent =
    state.turning ? "turning …" : state.reading_deg === undefined ? "–" : `${state.reading_deg.toFixed(4)}°`;
  fileQuery = page.local ? "" : query;
  CAMERAS.forEach((camera) => { faults[camera] = state[`fault_${camera}`] || ""; });
  showRole(page);
  showJob(state);
  showSteps(state);
  showAsked(state.asked || null);
  showQuestion(state.question, page);
  showLog(state.log);
  fillPositions($("positions"), state.measurements || []);
  fillLengths($("lengths"), state.lengths || []);
  $("lengths-part").hidden = $("lengths-csv").hidden = !(state.lengths || []).length;
  $("scene-text").textContent = drawScene($("scene"), state);
  showDocuments(state.files || []);
  enable(state, page);
  document.body.dataset.ready = "yes";
  document.body.dataset.job = state.job ? state.job.name : "";
}

function pill(text, kind) {
  $("role").textContent = text;
  $("role").className = `pill ${kind}`;
}

function showRole(page) {
  if (page.role === "owner") pill("this page has the motor", "owner");
  else if (!page.may_command) pill("only watching: opened without the token", "");
  else pill(page.owned ? "watching: another page has the motor" : "watching", "");
  $("take").hidden = !(page.may_command && !page.owned);
}

function showJob(state) {
  const { job, waiting } = state;
  $("job").textContent = job ? job.name : "idle";
  const counted = job && job.done !== null && job.of;
  $("step").textContent = !job ? "" : counted ? `${job.step}, ${job.done} of ${job.of}`
    : job.done !== null ? `stage ${job.done}: ${job.step}` : job.step;
  const bar = $("progress");
  bar.hidden = !job;
  if (counted) { bar.max = job.of; bar.value = job.done; } else bar.removeAttribute("value");
  $("waiting").textContent = waiting.length ? `then: ${waiting.join(", ")}` : "";
}

function showSteps(state) {
  const { check, rows, calibration, pictures, rig } = state;
  const text = (id, words, bad) => {
    $(id).textContent = words;
    $(id).classList.toggle("bad", Boolean(bad));
  };
  if (check) {
    const failed = check.checks.filter((one) => !one.passed);
    if (failed.length) text("check-text", `not fit: ${failed.map((one) => one.name).join(", ")}`, true);
    else text("check-text", `fit, u of a reading ${check.u_alpha2_deg.toFixed(4)}°`);
  }
  if (pictures) {
    const { c1, c2, pairs, sweep } = pictures;
    text("pictures-text", c1 + c2 + pairs + sweep ? `C1 ${c1}, C2 ${c2}, pairs ${pairs}, sweep ${sweep}` : "none yet");
  }
  if (rows && rig) {
    const validation = rows.validation ? ` and ${rows.validation} for validation` : "";
    text("capture-text", `${rows.gaze} rows${validation} in ${rig.dataset}`);
  }
  if (calibration) {
    const [near, far] = calibration.depths_mm;
    const failed = calibration.failed_gates.length;
    text("calibrate-text",
      `${calibration.path}, ${near.toFixed(0)} to ${far.toFixed(0)} mm${failed ? ", a gate failed" : ""}`, failed);
  } else text("calibrate-text", "no calibration yet");
}

// What the board is to do: the outline goes into the pictures, the words below the job.
function showAsked(asked) {
  ask(asked);
  $("asked").hidden = !asked;
  if (asked) $("asked").textContent = `Fill the outline in ${asked.camera.toUpperCase()}: ${asked.why}${asked.fault ? ` · ${asked.fault}` : ""}`;
}

function showQuestion(question, page) {
  const form = $("question");
  const appears = question && form.hidden;
  form.hidden = !question || page.role !== "owner";
  if (!question) return;
  $("question-text").textContent = question.text;
  $("answer").hidden = question.kind !== "number";
  if (appears && !form.hidden) {
    $("answer").value = "";
    (question.kind === "number" ? $("answer") : form.querySelector("button")).focus();
  }
}

function showLog(lines) {
  const last = lines.length ? lines[lines.length - 1] : null;
  const key = `${lines.length} ${last ? last.at + last.text : ""}`;
  const log = $("log");
  if (log.dataset.key === key) return;
  log.dataset.key = key;
  log.replaceChildren(...lines.map((line) => {
    const item = document.createElement("li");
    const at = document.createElement("time");
    at.textContent = line.at;
    item.append(at, line.text);
    item.className = line.kind;
    return item;
  }));
  log.scrollTop = log.scrollHeight;
}

const PAGES = ["report.html", "certificate.html"];

function showDocuments(files) {
  $("documents").hidden = !files.length;
  const key = files.map((file) => file.name + file.at).join();
  if ($("documents").dataset.key === key) return;
  $("documents").dataset.key = key;
  const pages = files.filter((file) => PAGES.includes(file.name));
  $("tabs").replaceChildren(...pages.map((file) => {
    const tab = document.createElement("button");
    tab.type = "button";
    tab.textContent = file.title;
    tab.setAttribute("role", "tab");
    tab.onclick = () => openDocument(file, pages);
    return tab;
  }));
  $("downloads").replaceChildren(...files.filter((f) => !PAGES.includes(f.name)).map((file) => {
    const link = document.createElement("a");
    link.href = `run/${file.name}${fileQuery}`;
    link.textContent = file.title;
    link.download = file.name;
    return link;
  }));
  if (pages.length) openDocument(pages.find((file) => file.name === shownDocument) || pages[0], pages);
}

function openDocument(file, pages) {
  shownDocument = file.name;
  $("document").title = file.title;
  $("document").src = `run/${file.name}${fileQuery}${fileQuery ? "&" : "?"}at=${file.at}`;
  pages.forEach((page, i) => {
    $("tabs").children[i].setAttribute("aria-selected", String(page === file));
  });
}

function notice(text) {
  $("notice").textContent = text;
  $("notice").hidden = !text;
}

function enable(state, page) {
  const owner = state !== null && page.role === "owner";
  const ready = owner && !state.job && !state.waiting.length;
  $("stop").disabled = !page.may_command;
  $("check").disabled = !(ready && state.rig && state.rig.board);
  $("capture").disabled = !(ready && (state.check || state.rig.u_alpha2_deg !== null));
  $("pictures").disabled = !(ready && state.rig && state.rig.board);
  $("calibrate").disabled = !(ready && state.rows && state.rows.gaze > 0);
  $("gaze").disabled = !(owner && state.calibration);
  $("length").disabled = !(owner && state.calibration);
}

function asked(id, command) {
  $(id).onclick = () => {
    const wrong = [...$(id).parentElement.querySelectorAll("input")].find((field) => !field.checkValidity());
    notice(wrong ? `${wrong.labels[0].firstChild.data.trim()}: ${wanted(wrong)}` : "");
    if (wrong) { wrong.focus(); return; }
    send(command());
    // Until the next state comes, which says what may be asked for: a click that is doubled is one.
    if (ONCE.includes(id)) $(id).disabled = true;
  };
}

const wanted = (field) =>
  field.type === "number" ? `give a whole number from ${field.min} to ${field.max}` : "name a target";
const whole = (id) => Number($(id).value);
asked("stop", () => ({ do: "stop" }));
asked("take", () => ({ do: "take" }));
asked("check", () => ({ do: "check" }));
asked("pictures", () => ({ do: "pictures", kind: $("pictures-kind").value }));
asked("capture", () => ({ do: "capture", kind: $("kind").value, count: whole("rows"), target: $("target").value }));
asked("calibrate", () => ({ do: "calibrate" }));
asked("gaze", () => ({ do: "gaze", count: whole("count"), target: $("target").value }));
asked("length", () => ({ do: "length", start: $("from").value, end: $("to").value }));
for (const id of ["target", "from", "to"]) $(id).addEventListener("focus", () => { pickFor = id; });
for (const camera of CAMERAS) {
  $(camera).onclick = (event) => {
    const scale = $(camera).width / $(camera).clientWidth;
    notice("");
    send({ do: "pick", camera, u: event.offsetX * scale, v: event.offsetY * scale });
  };
}
$("target").onchange = () => $("target").checkValidity() && send({ do: "mark", target: $("target").value });
$("question").onsubmit = (event) => {
  event.preventDefault();
  send({ do: "answer", text: $("answer").hidden ? "" : $("answer").value });
};
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") send({ do: "stop" });
});
// A picture that never came is asked for again: asking twice is asking once.
setInterval(() => { if (!document.hidden) CAMERAS.forEach((camera) => send({ do: "picture", camera })); }, AGAIN_PICTURE_MS);
setInterval(() => CAMERAS.forEach((camera) => ageOf(camera, faults[camera], $)), 1000);
// A page that is left must not keep the motor until the connection is found dead.
addEventListener("pagehide", () => { if (socket) { socket.onclose = null; socket.close(); } });
$("csv").href += query;
$("lengths-csv").href += query;
connect();
