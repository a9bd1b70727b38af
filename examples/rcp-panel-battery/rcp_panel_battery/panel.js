const $ = (id) => document.getElementById(id);
const send = (message) => parent.postMessage({ rcp: 1, ...message }, "*");
let requests = 0;

const on = {
  init({ theme, writable }) {
    document.documentElement.dataset.theme = theme;
    $("set").disabled = !writable;
  },
  update({ name, value }) {
    if (name !== "battery") return;
    $("charge").value = value.percentage;
    $("told").textContent = `${Math.round(value.percentage * 100)} %`;
  },
  ended({ error }) {
    $("told").textContent = `${error.message}. ${error.remedy}`;
  },
  reply({ error, value }) {
    $("answer").textContent = error ? `${error.message}. ${error.remedy ?? ""}` : `set to ${value}`;
  },
};

addEventListener("message", ({ source, data }) => {
  if (source === parent && data?.rcp === 1) on[data.type]?.(data);
});
$("form").addEventListener("submit", (event) => {
  event.preventDefault();
  send({ type: "write", id: ++requests, name: "limit", value: Number($("limit").value) });
});
send({ type: "hello" });
send({ type: "subscribe", name: "battery", rate: 2 });
