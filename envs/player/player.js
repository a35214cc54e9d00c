// The page: synchronized episodes, time line, keyboard control.

const SPEEDS = [1, 2, 5, 10, 20, 50, 100, 200];
const PLAY_TIME = 45; // target duration of playback at the default speed [s]
const LEAST_ERROR = 1e-3; // below, no error is plotted [m]
const hasCandidates = (episode) => episode.candidates.length > 0;
const hasChosen = (episode) => episode.decision_chosen.some((chosen) => chosen >= 0) || episode.hasMarker(CHOSEN);
const hasScan = (episode) => episode.scans.some((step) => step > 0 && step !== episode.noReturn);
const hasError = (episode) => episode.errors.some((error) => error > LEAST_ERROR);
const hasEstimate = (episode) => episode.hasMap || episode.isAstray;
const hasBody = (...kinds) => (episode) => episode.bodies.some((kind) => kinds.includes(kind));
// Text, color, class, and whether an episode has it. The first group is on the left panel.
const LEGEND = [
  ["goal", "goal", "dot", (episode) => episode.goals.some((value) => !Number.isNaN(value))],
  ["route", "goal", "", (episode) => episode.worldRoute.length],
  ["true path", "true", "", () => true],
  ["scan", "lidar", "dot", hasScan],
  ["person", "person", "dot", hasBody("attentive", "standing", "fixed_route")],
  ["person who ignores the robot", "person", "dot blind", hasBody("blind")],
  ["other robot", "person", "dot", hasBody("robot")],
  ["person or other robot", "person", "dot", hasBody("")],
  ["estimated path", "estimated", "", hasEstimate],
  ["frontier", "frontier", "", (episode) => episode.hasFrontier()],
  ["global tree", "global", "", (episode) => episode.hasMarker(GLOBAL_TREE)],
  ["local tree, found points", "local", "", (episode) => episode.hasMarker(LOCAL_TREE) || episode.hasMarker(POINT)],
  ["predicted floor", "predicted", "dot", (episode) => episode.hasMarker(PREDICTED)],
  ["tour", "tour", "", (episode) => episode.hasMarker(TOUR)],
  ["candidate", "frontier", "dot", (episode) => hasCandidates(episode) || episode.hasMarker(CLUSTER)],
  ["chosen candidate", "plan", "dot", hasChosen],
  ["plan", "plan", "", (episode) => episode.plans.length],
  ["tracked person", "tracked", "ring", (episode) => episode.tracks.length],
  ["contact", "contact", "", (episode) => episode.contacts.some((count) => count > 0)],
];

/** Return a new element with attributes and children. */
function element(tag, attributes = {}, ...children) {
  const made = Object.assign(document.createElement(tag), attributes);
  made.append(...children);
  return made;
}

const capitalised = (text) => text[0].toUpperCase() + text.slice(1);
const byId = (id) => document.getElementById(id);

/** One episode: heading, current values, two panels. */
class Row {
  constructor(episode, number, namesWorld) {
    const { about } = episode, name = about.explorer || "explorer";
    this.episode = episode;
    this.hasCandidates = hasCandidates(episode);
    const isMixed = !episode.hasMap && (episode.plans.length || episode.tracks.length || episode.isAstray);
    const titles = [`Ground truth${isMixed ? " and estimates" : ""}`, ...(episode.hasMap ? ["Map and estimates"] : [])];
    const canvases = titles.map((title) => {
      const canvas = element("canvas");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${title} of ${name}`);
      return canvas;
    });
    const tip = element("div", { className: "tip", hidden: true });
    const [truth, map] = canvases;
    const figures = canvases.map((canvas, k) =>
      element("figure", {}, canvas, ...(canvas === map ? [tip] : []), element("figcaption", {}, titles[k])),
    );
    this.now = [about.progress, "pose error", "path", "contacts"].map((title) => [title, element("b")]);
    const shown = this.now.filter(([title]) => title !== "pose error" || hasError(episode));
    this.decision = element("p", { className: "decision" });
    const facts = [namesWorld ? about.world : "", about.robot, about.seed === undefined ? "" : `seed ${about.seed}`].filter(Boolean);
    this.element = element(
      "section",
      { className: "episode" },
      element(
        "div",
        { className: "head" },
        element("h3", {}, name),
        element("span", { className: "muted" }, facts.join(", ")),
        element("span", { className: "now" }, ...shown.map(([title, value]) => element("span", {}, `${title} `, value))),
        ...(this.hasCandidates ? [] : [this.decision]),
      ),
      element("div", { className: "pair" }, ...figures),
      ...(this.hasCandidates ? [this.decision] : []),
    );
    this.element.style.setProperty("--color", `var(--${number ? "second" : "first"})`);
    this.panels = new Panels(episode, truth, map, tip);
  }

  draw(time, shown) {
    const { episode } = this, i = episode.sampleAt(time);
    const texts = [
      `${(100 * episode.progress[i]).toFixed(1)} %`,
      `${(100 * episode.errors[i]).toFixed(1)} cm`,
      `${episode.path_length[i].toFixed(1)} m`,
      String(episode.contacts[i]),
    ];
    this.now.forEach(([, value], k) => (value.textContent = texts[k]));
    this.panels.draw(time, shown);
    this.decision.textContent = time > episode.end ? this.ending() : this.decided(time);
  }

  ending() {
    const { end, about } = this.episode, reason = (about.end_reason || "").replaceAll("_", " ");
    return `Ended after ${clockText(end)}${reason ? `: ${reason}` : ""}.`;
  }

  /** Describe the last decision. */
  decided(time) {
    const { episode } = this, k = episode.decisionAt(time), candidates = episode.candidatesOf(k);
    if (k < 0 || !this.hasCandidates) return "";
    const chosen = candidates.findIndex((one) => one.isChosen);
    const when = `Decision ${k + 1} of ${episode.decision_times.length}, ${clockText(episode.decision_times[k])}`;
    if (chosen < 0) return `${when}: none of ${candidates.length} candidates`;
    const one = candidates[chosen], score = Number.isNaN(one.score) ? "" : `, score ${one.score.toFixed(2)}`;
    const order = Number.isNaN(one.score) ? "by path" : "by score";
    const found = `path ${one.cost.toFixed(1)} m, unknown in view ${one.visible.toFixed(1)} m²${score}`;
    return `${when}: ${found}; number ${chosen + 1} of ${candidates.length} ${order}`;
  }
}

class Player {
  constructor(episodes) {
    this.end = Math.max(...episodes.map((episode) => episode.end));
    const worlds = new Set(episodes.map((episode) => episode.about.world)); // a single one is in the title
    this.rows = episodes.map((episode, k) => new Row(episode, k, worlds.size > 1));
    byId("episodes").append(...this.rows.map((row) => row.element));
    const isBare = !episodes.some((episode) => episode.hasMap);
    byId("episodes").className = `${episodes.length > 1 ? "two" : "one"} ${isBare ? "bare" : ""}`;
    for (const [text, color, kind, isShown] of LEGEND) {
      if (!episodes.some(isShown)) continue;
      const mark = element("span", {}, kind.includes("blind") ? "×" : "");
      mark.style.setProperty("--mark", `var(--${color === "tracked" ? (isBare ? "estimated" : "person") : color})`);
      byId("legend").append(element("li", { className: kind }, mark, text));
    }
    byId("about-candidates").hidden = !episodes.some(hasCandidates);
    const hasGoals = (episode) => hasCandidates(episode) || episode.markers.length > 0;
    byId("show-candidates").closest("label").hidden = !episodes.some(hasGoals);
    byId("show-scan").closest("label").hidden = !episodes.some(hasScan);
    const seek = (time) => this.seek(time), title = capitalised(episodes[0].about.progress);
    const percent = (episode) => episode.progress.map((value) => 100 * value);
    const centimetres = (episode) => episode.errors.map((value) => 100 * value);
    this.plots = [new Plot(byId("plot-progress"), `${title} [%]`, episodes, percent, this.end, seek)];
    if (episodes.some(hasError)) {
      this.plots.push(new Plot(byId("plot-error"), "Position error [cm]", episodes, centimetres, this.end, seek));
    } else byId("plot-error").closest("figure").hidden = true;
    this.fillFigures(episodes);
    this.connect();
    byId("status").hidden = true;
    for (const id of ["player", "controls"]) byId(id).hidden = false;
    this.layout();
    if (this.size() !== this.laidOut) this.layout(); // the texts, now drawn, take room
  }

  connect() {
    const slider = byId("time"), speed = byId("speed");
    slider.max = this.end;
    slider.addEventListener("input", () => this.seek(Number(slider.value)));
    byId("play").addEventListener("click", () => this.play(!this.isPlaying));
    byId("show-details").addEventListener("click", () => byId("details").showModal());
    speed.append(...SPEEDS.map((one) => element("option", { value: one }, `${one} x`)));
    speed.value = SPEEDS.find((one) => this.end / one <= PLAY_TIME) || SPEEDS[SPEEDS.length - 1];
    for (const id of ["show-candidates", "show-scan"]) byId(id).addEventListener("change", () => this.draw());
    document.addEventListener("keydown", (event) => this.onKey(event));
    const observer = new ResizeObserver(() => this.size() !== this.laidOut && this.layout());
    for (const canvas of document.querySelectorAll("canvas")) observer.observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.layout());
    const fromHash = () => this.seek(Number((location.hash.match(/t=([\d.]+)/) || [0, 0])[1]));
    window.addEventListener("hashchange", fromHash);
    this.time = 0;
    fromHash();
  }

  onKey(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
    const step = event.shiftKey ? 30 : 5;
    const targets = { ArrowLeft: this.time - step, ArrowRight: this.time + step, Home: 0, End: this.end };
    const isControl = ["BUTTON", "INPUT"].includes(event.target.tagName) && event.target.id !== "time";
    if (event.key in targets) this.seek(targets[event.key]);
    else if (event.key === " " && !isControl) this.play(!this.isPlaying);
    else return;
    event.preventDefault();
  }

  seek(time) {
    this.time = Math.min(Math.max(time || 0, 0), this.end);
    if (this.laidOut) this.draw();
  }

  play(isPlaying) {
    this.isPlaying = isPlaying;
    byId("play").textContent = isPlaying ? "Pause" : "Play";
    if (!isPlaying) return;
    if (this.time >= this.end) this.time = 0;
    let before = performance.now();
    const step = (now) => {
      if (!this.isPlaying) return;
      this.seek(this.time + ((now - before) / 1000) * Number(byId("speed").value));
      before = now;
      if (this.time >= this.end) this.play(false);
      else requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  /** Return the sizes of all canvases, as text. */
  size() {
    return [...document.querySelectorAll("canvas")].map((one) => `${one.clientWidth} x ${one.clientHeight}`).join();
  }

  layout() {
    for (const part of [...this.rows.map((row) => row.panels), ...this.plots]) part.layout();
    this.laidOut = this.size();
    this.draw();
  }

  draw() {
    const { time } = this, slider = byId("time");
    const shown = { candidates: byId("show-candidates").checked, scan: byId("show-scan").checked };
    for (const row of this.rows) row.draw(time, shown);
    for (const plot of this.plots) plot.draw(time);
    slider.value = time;
    slider.setAttribute("aria-valuetext", `${clockText(time)} of ${clockText(this.end)}`);
    byId("clock").textContent = `${clockText(time)} / ${clockText(this.end)}`;
  }

  fillFigures(episodes) {
    const names = [...new Set(episodes.flatMap((episode) => Object.keys(episode.about.figures)))];
    const head = episodes.map((episode) => element("th", { scope: "col" }, episode.about.explorer || "explorer"));
    const lines = names.map((name) => {
      const cells = episodes.map((episode) => element("td", {}, episode.about.figures[name] ?? ""));
      return element("tr", {}, element("th", { scope: "row" }, name), ...cells);
    });
    byId("figures").append(element("thead", {}, element("tr", {}, element("td"), ...head)), element("tbody", {}, ...lines));
    byId("figures").closest("section").hidden = !names.length;
  }
}

async function open() {
  const player = new Player(await readEpisodes(byId("data").textContent));
  const state = document.documentElement.dataset;
  state.samples = player.rows.map((row) => row.episode.count).join(" ");
  state.loadedAfter = Math.round(performance.now()); // time since the page request [ms]
}

open().catch((error) => {
  byId("status").textContent = `This page cannot be shown: ${error.message}. It requires a browser of 2023 or later.`;
  throw error;
});
