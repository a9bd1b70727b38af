/** Whether nobody is seen to be at this page: it is hidden, the keyboard is somewhere else, or a dialog covers it. */
export function away(): boolean {
  return document.hidden || !document.hasFocus() || document.querySelector("dialog:modal") !== null;
}
