// What a reader can do with the page: theme, folding, printing, tables. The page says the same without this script.
(() => {
  "use strict";
  const root = document.documentElement;
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];

  // -- theme --
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme ? root.dataset.theme === "dark" : dark.matches);
  const toggle = document.getElementById("theme");
  const nameTheme = () => { toggle.textContent = isDark() ? "Light" : "Dark"; };
  toggle.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    nameTheme();
  });
  dark.addEventListener("change", nameTheme);
  nameTheme();

  // -- folding --
  const unfoldTarget = () => {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let part = target.closest("details"); part; part = part.parentElement.closest("details")) part.open = true;
    target.scrollIntoView();
  };
  addEventListener("hashchange", unfoldTarget);
  unfoldTarget();
  const fold = document.getElementById("fold");
  fold.addEventListener("click", () => {
    const sections = all("details.section");
    const open = !sections.every((section) => section.open);
    for (const section of sections) section.open = open;
    fold.textContent = open ? "Fold all" : "Unfold all";
  });

  // -- printing: what stays on record is open on paper, the rest only where a reader opened them --
  let folded = [];
  addEventListener("beforeprint", () => {
    folded = all("details.section.record").filter((part) => !part.open);
    for (const part of folded) part.open = true;
  });
  addEventListener("afterprint", () => {
    for (const part of folded) part.open = false;
  });

  // -- tables: copied as tab-separated values, saved as CSV, numbers in full precision --
  const rowsOf = (table) => [...table.rows].map((row) => [...row.cells].map((cell) => cell.dataset.value ?? cell.textContent.trim()));
  const csvCell = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const csvOf = (table) => rowsOf(table).map((row) => row.map(csvCell).join(",")).join("\r\n") + "\r\n";
  const tsvOf = (table) => rowsOf(table).map((row) => row.map((text) => text.replace(/\s+/g, " ")).join("\t")).join("\n");
  const copy = async (text) => {
    if (navigator.clipboard && isSecureContext) {
      await navigator.clipboard.writeText(text);
      return;
    }
    const area = document.createElement("textarea");
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  };
  const save = (name, text) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(["\ufeff", text], { type: "text/csv;charset=utf-8" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };
  const button = (words, label, act) => {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = words;
    made.setAttribute("aria-label", label);
    made.addEventListener("click", async () => {
      try {
        await act();
        made.textContent = "Done";
      } catch {
        made.textContent = "Not possible here";
      }
      setTimeout(() => { made.textContent = words; }, 1500);
    });
    return made;
  };
  for (const frame of all(".table")) {
    const table = frame.querySelector("table");
    const title = frame.getAttribute("aria-label");
    const file = `${title.replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-|-$/g, "").slice(0, 80) || "table"}.csv`;
    const tools = document.createElement("span");
    tools.className = "tools";
    tools.append(
      button("Copy", `Copy the table: ${title}`, () => copy(tsvOf(table))),
      button("CSV", `Save as CSV: ${title}`, () => save(file, csvOf(table))),
    );
    table.caption.append(tools);
  }
  // -- a table that is wider than its frame says that it scrolls --
  const hint = () => {
    for (const frame of all(".table")) frame.classList.toggle("scrolls", frame.scrollWidth > frame.clientWidth + 1);
  };
  for (const part of all("details")) part.addEventListener("toggle", hint);
  addEventListener("resize", hint);
  hint();
  for (const hidden of all("[data-scripted]")) hidden.hidden = false;
})();
