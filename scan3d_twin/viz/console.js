"use strict";
// Shows how the run stands, and sends what is pressed. All text is set as text, never as markup.
const PERIOD = 1000; // between two looks at the run [ms]
const COLOURS = { starting: "waiting", stopping: "stopped", saving: "running" };
const REMARKS = new Set(["Note", "Found", "Cure", "Actions"]); // columns of text
const columns = JSON.parse(document.getElementById("columns").textContent);
const at = (id) => document.getElementById(id);
let before = "", shownLines = "";

function make(name, text = "", attributes = {}, ...children) {
  const made = document.createElement(name);
  if (text !== "") made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

async function ask(path, body) {
  const options = body === undefined ? {} : {
    method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
  };
  const answer = await fetch(path, options);
  const content = await answer.json();
  if (!answer.ok) throw new Error(content.error);
  return content;
}

function refuse(words) {
  at("refusal").firstElementChild.textContent = words;
  at("refusal").hidden = words === "";
}

// Sends a request for a pressed button, which waits for the answer, and shows a refusal
async function press(button, words, path, body) {
  refuse("");
  button.disabled = true;
  if (words) at("work").textContent = words;
  try {
    return await ask(path, body);
  } catch (error) {
    refuse(error.message);
    return null;
  } finally {
    button.disabled = false;
    if (words) at("work").textContent = "";
  }
}

// --- The run -----------------------------------------------------------------------------------

function showRun(run) {
  const state = run.state;
  at("state").textContent = state;
  at("state").className = `badge ${COLOURS[state] || state}`;
  at("command").textContent = run.command;
  const last = run.error || run.lines.length === 0 ? "" : run.lines[run.lines.length - 1];
  at("last").textContent = last.replace(/^error: /, "");
  at("error").textContent = run.error;
  at("error").hidden = run.error === "";
  at("progress").hidden = run.lines.length === 0;
  showLines(run.lines.join("\n"));

  const steerable = run.steerable, paused = state === "paused" || state === "pausing";
  at("pause").hidden = paused;
  at("pause").disabled = !steerable;
  at("continue").hidden = !paused;
  at("stop").disabled = run.over || state === "stopping" || state === "saving";
  at("watch").hidden = run.live_view === "";
  if (run.live_view !== "") at("watch").href = viewAddress(run.live_view);
  if (before !== state && run.over) showRuns();
  before = state;
}

function showLines(lines) {
  if (lines === shownLines) return;
  const box = at("lines");
  const atEnd = box.scrollTop + box.clientHeight >= box.scrollHeight - 4;
  box.textContent = shownLines = lines;
  if (atEnd) box.scrollTop = box.scrollHeight;
}

// The live view is at the same machine as this page, by whichever name it was reached
function viewAddress(address) {
  const place = new URL(address);
  place.hostname = location.hostname;
  return place.href;
}

async function look() {
  try {
    const found = await ask("state");
    if (found.run) showRun(found.run);
  } catch {
    at("state").textContent = "no answer";
    at("state").className = "badge failed";
    at("last").textContent = "The console does not answer: was twin console ended?";
    for (const id of ["pause", "continue", "stop"]) at(id).disabled = true;
  }
  setTimeout(look, PERIOD);
}

for (const id of ["pause", "continue", "stop"]) {
  at(id).addEventListener("click", () => press(at(id), "", id, {}));
}

// --- A new run ---------------------------------------------------------------------------------

const values = (form) => Object.fromEntries(
  [...new FormData(form)].filter(([name]) => name !== "more").filter(([, value]) => value !== ""));

for (const each of document.querySelectorAll("input[name=kind]")) {
  each.addEventListener("change", () => {
    for (const form of document.forms) form.hidden = form.id !== each.value;
  });
}
for (const form of document.forms) {
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const body = { kind: form.id, options: values(form), more: form.elements.more.value };
    const answer = await press(form.querySelector("button"), "", "start", body);
    if (answer) {
      showRun(answer.run);
      at("now").scrollIntoView({ block: "start" });
    }
  });
}

// --- The robot ---------------------------------------------------------------------------------

at("check").addEventListener("click", async () => {
  at("findings").replaceChildren(make("p", "asking the devices ...", { class: "note" }));
  const form = at("real");
  const answer = await press(at("check"), "", "check", { options: values(form) });
  const rows = (answer ? answer.findings : []).map((each) => [
    make("td", each.what, { "data-label": "Check" }),
    make("td", "", { "data-label": "Result" },
      make("span", each.ok ? "ok" : "bad", { class: each.ok ? "found" : "found bad" })),
    make("td", each.found, { "data-label": "Found", class: "remark" }),
    make("td", each.cure, { "data-label": "Cure", class: "remark" }),
  ]);
  at("findings").replaceChildren(...(rows.length ? [table(["Check", "Result", "Found", "Cure"], rows)] : []));
  if (answer) showPorts(answer.ports);
});

function showPorts(ports) {
  const items = ports.map((each) => make("li", "", {}, make("code", each)));
  at("ports").replaceChildren(items.length ? make("ul", "", {}, ...items) : make("p", "No serial port on USB."));
}

function table(names, rows) {
  const head = names.map((name) => make("th", name, { scope: "col", class: REMARKS.has(name) ? "remark" : "" }));
  return make("div", "", { class: "scroll", tabindex: "0", role: "group", "aria-label": "Table" },
    make("table", "", {},
      make("thead", "", {}, make("tr", "", {}, ...head)),
      make("tbody", "", {}, ...rows.map((cells) => make("tr", "", {}, ...cells)))));
}

// --- Earlier runs ------------------------------------------------------------------------------

const marked = () => [...document.querySelectorAll("#runs input:checked")].map((box) => box.value).reverse();
const place = (run, file) => `run/${run.split("/").map(encodeURIComponent).join("/")}/${encodeURIComponent(file)}`;

async function showRuns() {
  const kept = new Set(marked());
  let found;
  try {
    found = (await ask("runs")).runs;
  } catch (error) {
    refuse(error.message);
    return;
  }
  const rows = found.map((run) => [
    make("td", "", { "data-label": "Run" }, mark(run, kept)),
    make("td", run.written, { "data-label": "Written" }),
    ...run.cells.map((cell, k) => make("td", cell, { "data-label": columns[k] })),
    make("td", run.notes.join("; "), { "data-label": "Note", class: "remark" }),
    make("td", "", { class: "actions" }, actions(run)),
  ]);
  const names = ["Run", "Written", ...columns, "Note", "Actions"];
  at("runs").replaceChildren(rows.length ? table(names, rows) : make("p", "None yet.", { class: "note" }));
  countMarked();
}

function mark(run, kept) {
  const box = make("input", "", { type: "checkbox", value: run.name });
  box.checked = kept.has(run.name);
  box.addEventListener("change", countMarked);
  return make("label", "", {}, box, make("span", run.name));
}

function countMarked() {
  at("compare").disabled = marked().length < 2;
}

function actions(run) {
  const bar = make("div", "", { class: "bar" });
  if (run.files.includes("report.html")) {
    bar.append(make("a", "Report", { class: "button", href: place(run.name, "report.html"),
      target: "_blank", rel: "noopener noreferrer", "aria-label": `Report of ${run.name}` }));
  }
  bar.append(action(run, "Export", async (button) => {
    const body = { run: run.name, format: at("format").value };
    const answer = await press(button, "exporting ...", "export", body);
    if (answer) {
      await showRuns();
      at("work").textContent = `${run.name}: ${answer.written}`;
    }
  }));
  bar.append(action(run, "Resume", (button) => press(button, "", "resume", { run: run.name })));
  const items = run.files.map((file) => make("li", "", {}, make("a", file, { href: place(run.name, file) })));
  const files = make("summary", "Files", { "aria-label": `Files of ${run.name}` });
  bar.append(make("details", "", {}, files, make("ul", "", {}, ...items)));
  return bar;
}

function action(run, name, act) {
  const button = make("button", name, { "aria-label": `${name} ${run.name}` });
  button.addEventListener("click", () => act(button));
  return button;
}

at("compare").addEventListener("click", async () => {
  at("comparison").hidden = true;
  const answer = await press(at("compare"), "comparing ...", "compare", { runs: marked() });
  at("comparison").hidden = !answer;
  if (answer) at("comparison").focus();
  countMarked();
});

at("refusal").querySelector("button").addEventListener("click", () => refuse(""));
showRuns();
look();
