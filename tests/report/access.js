// What keeps a page from people who see little, or use a keyboard or a reader: written into it as JSON, for test_browser.
addEventListener("load", () => setTimeout(() => {
  const number = text => (text.match(/[\d.]+/g) || []).map(Number);
  const light = ([r, g, b]) => [[r, .2126], [g, .7152], [b, .0722]].reduce((sum, [c, k]) => {
    const s = c / 255;
    return sum + k * (s <= .04045 ? s / 12.92 : ((s + .055) / 1.055) ** 2.4);
  }, 0);
  const behind = e => {
    for (; e; e = e.parentElement) { const c = number(getComputedStyle(e).backgroundColor); if (c.length === 3 || c[3] > .99) return c; }
    return [255, 255, 255];
  };
  const faint = new Set(), nameless = [], dead = [], bare = [];
  for (const details of document.querySelectorAll("details")) details.open = true;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const e = walker.currentNode.parentElement, style = getComputedStyle(e);
    if (!walker.currentNode.textContent.trim() || e.closest("script,style") || !e.getClientRects().length) continue;
    const ink = e.closest("svg") ? style.fill : style.color, [a, b] = [light(number(ink)), light(behind(e))].sort((x, y) => y - x);
    const large = parseFloat(style.fontSize) >= 24 || (parseFloat(style.fontSize) >= 18.66 && Number(style.fontWeight) >= 700);
    if ((a + .05) / (b + .05) < (large ? 3 : 4.5)) faint.add(`${walker.currentNode.textContent.trim().slice(0, 30)} ${ink}`);
  }
  for (const e of document.querySelectorAll("button,select,input,a[href]")) {
    if (!(e.textContent.trim() || e.getAttribute("aria-label") || e.labels?.length)) nameless.push(e.outerHTML.slice(0, 80));
    e.focus();
    const style = getComputedStyle(e);
    if (e.getClientRects().length && (document.activeElement !== e || style.outlineStyle === "none")) dead.push(e.outerHTML.slice(0, 80));
  }
  for (const e of document.querySelectorAll("abbr[title]")) if (e.tabIndex !== 0) dead.push(e.outerHTML.slice(0, 80));
  for (const e of document.querySelectorAll("th")) if (!e.hasAttribute("scope")) bare.push(e.outerHTML.slice(0, 80));
  for (const e of document.querySelectorAll("img,svg,[role=img]")) {
    if (!(e.getAttribute("alt") || e.getAttribute("aria-label")) && !e.closest("[aria-hidden=true]")) bare.push(e.outerHTML.slice(0, 80));
  }
  for (const e of document.querySelectorAll("table")) if (!e.caption) bare.push(e.outerHTML.slice(0, 80));
  const paper = getComputedStyle(document.body).backgroundColor, headings = [...document.querySelectorAll("h1,h2,h3")].map(e => Number(e.tagName[1]));
  const skips = headings.filter((level, k) => level > (headings[k - 1] ?? 0) + 1).length;
  const told = { faint: [...faint], nameless, dead, bare, skips, lang: document.documentElement.lang, dark: light(number(paper)) < .2 };
  document.body.innerHTML = `<pre id="told"></pre>`;
  document.getElementById("told").textContent = JSON.stringify(told);
}, 500));
