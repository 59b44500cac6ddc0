// Functions by which the tests examine a page. They run in the page beside its own script.
(() => {
  const parse = (colour) => {
    const [r, g, b, a] = colour.match(/[\d.]+/g).map(Number);
    return [r, g, b, a === undefined ? 1 : a];
  };
  const over = (front, back, opacity) => {
    const a = front[3] * opacity;
    return [0, 1, 2].map((i) => a * front[i] + (1 - a) * back[i]).concat(1);
  };
  const luminance = (colour) => {
    const [r, g, b] = colour.map((c) => (c / 255 <= 0.04045 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  // WCAG 2.2, contrast ratio.
  const contrast = (a, b) => {
    const [light, dark] = [luminance(a), luminance(b)].sort((x, y) => y - x);
    return (light + 0.05) / (dark + 0.05);
  };
  const behind = (element) => {
    const layers = [];
    for (let e = element; e !== null; e = e.parentElement) layers.push(parse(getComputedStyle(e).backgroundColor));
    return layers.reverse().reduce((back, front) => over(front, back, 1), [255, 255, 255, 1]);
  };
  const opacity = (element) => {
    let all = 1;
    for (let e = element; e !== null; e = e.parentElement) all *= Number(getComputedStyle(e).opacity);
    return all;
  };

  const texts = () => {
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const element = walker.currentNode.parentElement;
      const text = walker.currentNode.data.trim();
      if (text === "" || element.closest("script, style, title") || element.getClientRects().length === 0) continue;
      const style = getComputedStyle(element);
      const drawn = element.closest("svg") !== null;
      const colour = parse(drawn ? style.fill : style.color);
      const back = behind(element);
      const size = parseFloat(style.fontSize);
      const large = !drawn && (size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700));
      const see = (drawn ? Number(style.fillOpacity) : 1) * opacity(element);
      found.push({ what: text.slice(0, 40), ratio: contrast(over(colour, back, see), back), least: large ? 3 : 4.5 });
    }
    return found;
  };

  const graphics = () => {
    const marks = "path, circle, rect";
    return Array.from(document.querySelectorAll("svg")).flatMap((svg) => Array.from(svg.querySelectorAll(marks)))
      .filter((e) => !e.matches(".grid, .band, .rim") && (e.getAttribute("d") !== ""))
      .map((e) => {
        const style = getComputedStyle(e);
        const back = behind(e);
        const part = (colour, see) => colour === "none" ? 1 : contrast(over(parse(colour), back, Number(see) * opacity(e)), back);
        const ratio = Math.max(part(style.stroke, style.strokeOpacity), part(style.fill, style.fillOpacity));
        return { what: e.tagName + " " + e.getAttribute("class"), ratio, least: 3 };
      });
  };

  const points = (path) => (path.getAttribute("d") || "").split("M").slice(1).map((d) => d.split("h")[0].split(" ").map(Number));
  const plots = () => Array.from(document.querySelectorAll("svg[data-plane]"));

  window.tests = {
    // Texts and marks with too little contrast, and the number of those that were examined.
    contrasts: () => {
      const all = texts().concat(graphics());
      return { count: all.length, low: all.filter((one) => one.ratio < one.least).map((one) => one.what + " " + one.ratio.toFixed(2)) };
    },
    numbers: () => Array.from(document.querySelectorAll("data[data-json]"), (e) => [e.dataset.json, Number(e.value), e.textContent]),
    plots: () => plots().map((svg) => ({
      name: Array.from(svg.querySelectorAll("text.label")).pop().textContent,
      plane: svg.dataset.plane.split(" ").map(Number),
      ends: svg.dataset.x.split(" ").map(Number),
      focused: document.activeElement === svg,
      series: Array.from(svg.querySelectorAll("path[data-poses]"), points),
      cores: Array.from(svg.querySelectorAll("path.core"), points),
      marked: Array.from(svg.querySelectorAll("path.marked"), points),
      box: (({ left, top, width }) => ({ left, top, scale: width / svg.viewBox.baseVal.width }))(svg.getBoundingClientRect()),
    })),
    // The state of the plot with this index, or of the one with the focus.
    state: (index) => {
      const svg = index === undefined ? document.activeElement : plots()[index];
      const tip = document.querySelector(".tip");
      return {
        plot: plots().indexOf(svg),
        tip: tip.hidden ? "" : Array.from(tip.children, (part) => part.textContent + (part.className === "name" ? ": " : "\n")).join(""),
        said: document.querySelector(".said").textContent,
        cores: Array.from(svg.querySelectorAll("path.core"), points),
        whole: tip.hidden || (({ left, right, top, bottom }) => left >= 0 && right <= innerWidth + 1 && top >= 0 && bottom <= innerHeight + 1)(tip.getBoundingClientRect()),
      };
    },
    panel: () => document.querySelector(".panel").hidden ? "" : document.querySelector(".panel span").textContent,
    text: () => document.querySelector("main").textContent + document.querySelector("header").textContent + document.querySelector("footer").textContent,
    sideways: () => document.documentElement.scrollWidth - innerWidth,
  };
  return true;
})()
