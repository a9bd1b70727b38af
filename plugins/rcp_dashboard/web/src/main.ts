import { mount } from "svelte";

import App from "./App.svelte";
import "./app.css";
import { app } from "./lib/app.svelte.ts";
import { theme } from "./lib/theme.svelte.ts";

const target = document.getElementById("app");
if (target === null) throw new Error("index.html has no #app");
theme.apply();
void app.open();
mount(App, { target });
