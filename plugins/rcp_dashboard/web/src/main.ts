import { mount } from "svelte";

import App from "./App.svelte";
import "./app.css";
import { app } from "./lib/app.svelte.ts";
import { language } from "./lib/language.svelte.ts";
import { theme } from "./lib/theme.svelte.ts";

const PATIENCE = 3000; // ms
const target = document.getElementById("app");
if (target === null) throw new Error("index.html has no #app");
theme.apply();
void app.open();
// The page begins in its language. It does not wait long for the catalogue: until that comes it is in English.
void Promise.race([language.begin(), new Promise((resolve) => setTimeout(resolve, PATIENCE))]).then(() => mount(App, { target }));
