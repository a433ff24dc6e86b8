/** Run once an element comes near the view: what nobody looks at need not be drawn. @param {Element} element @param {() => void} run */
export function whenSeen(element, run) {
  const observer = new IntersectionObserver((entries) => {
    if (!entries.some((entry) => entry.isIntersecting)) return;
    observer.disconnect();
    run();
  }, { rootMargin: "200px" });
  observer.observe(element);
}
