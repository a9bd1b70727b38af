const MARGIN = "300px"; // what is about to come into sight is there when it does

type Told = (seen: boolean, height: number) => void;

const told = new Map<Element, Told>();
/** One for all elements: of hundreds, each would be looked at again in every frame. */
const observer = new IntersectionObserver(
  (entries) => {
    const newest = new Map(entries.map((one) => [one.target, one]));
    for (const [element, one] of newest) told.get(element)?.(one.isIntersecting, one.boundingClientRect.height);
  },
  { rootMargin: MARGIN },
);

/** Tell whether an element can be seen, and how high it is (px), each time that the former changes. */
export function inSight(tell: Told): (element: Element) => () => void {
  return (element) => {
    told.set(element, tell);
    observer.observe(element);
    return () => {
      observer.unobserve(element);
      told.delete(element);
    };
  };
}
