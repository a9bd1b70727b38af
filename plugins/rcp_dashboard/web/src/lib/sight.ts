const MARGIN = "300px"; // what is about to come into sight is there when it does

/** Tell whether an element can be seen, each time that changes. */
export function inSight(told: (seen: boolean) => void): (element: Element) => () => void {
  return (element) => {
    const observer = new IntersectionObserver((entries) => told(entries.at(-1)?.isIntersecting ?? false), { rootMargin: MARGIN });
    observer.observe(element);
    return () => observer.disconnect();
  };
}
