// Panels of an episode: ground truth, and map with estimates; without a map, ground truth with estimates.

const TIP_REACH = 16; // maximum pointer distance from a candidate [px]
const LABELS = 6; // maximum number of displayed scores

class Panels {
  constructor(episode, truth, map, tip) {
    Object.assign(this, { episode, truth, map, tip, bounds: boundsOf(episode), candidates: [] });
    this.showsPath = map || episode.isAstray;
    this.image = document.createElement("canvas");
    [this.image.width, this.image.height] = [episode.cols, episode.rows];
    this.imageContext = this.image.getContext("2d");
    this.pixels = this.imageContext.createImageData(episode.cols, episode.rows);
    this.words = new Uint32Array(this.pixels.data.buffer);
    this.world = document.createElement("canvas");
    if (!map) return;
    for (const type of ["pointermove", "pointerdown"]) map.addEventListener(type, (event) => this.point(event));
    map.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "mouse") tip.hidden = true; // touch: keep the tip after release
    });
  }

  /** Adapt to screen size and theme. */
  layout() {
    const { bounds, episode } = this, ratio = (bounds[2] - bounds[0]) / (bounds[3] - bounds[1]);
    for (const canvas of [this.truth, this.map].filter(Boolean)) canvas.style.aspectRatio = ratio;
    this.width = this.truth.clientWidth;
    this.height = this.truth.clientHeight;
    this.view = new View(bounds, this.width, this.height);
    this.colors = themeColors();
    this.drawWorld();
    this.paint([0, 0, episode.rows - 1, episode.cols - 1]);
  }

  /** Draw both panels at a time [s]. */
  draw(time, { scan, candidates }) {
    const { episode } = this, moment = Math.min(time, episode.end), sample = episode.sampleAt(moment);
    const truePose = episode.poseAt(episode.true_poses, moment);
    const pose = episode.poseAt(episode.worldPoses, moment);
    const changed = episode.showMap(sample);
    if (changed) this.paint(changed);
    this.candidates = candidates ? episode.candidatesOf(episode.decisionAt(moment)) : [];
    this.markers = candidates ? episode.markersAt(sample) : [];
    this.drawTruth(sample, truePose, pose, scan);
    if (this.map) this.drawMap(sample, pose, truePose);
    this.tip.hidden = true;
  }

  /** Draw the static world: explorable floor and walls. */
  drawWorld() {
    const { episode, colors, view } = this, { floor, floorWidth, segments, circles } = episode;
    const raster = document.createElement("canvas");
    [raster.width, raster.height] = [floorWidth, floor.length / floorWidth];
    const context = raster.getContext("2d"), pixels = context.createImageData(raster.width, raster.height);
    const words = new Uint32Array(pixels.data.buffer), pixel = pixelOf(colors.floor);
    for (let k = 0; k < floor.length; k++) words[k] = floor[k] ? pixel : 0;
    context.putImageData(pixels, 0, 0);
    const world = prepare(this.world, this.width, this.height);
    world.fillStyle = colors.outside;
    world.fillRect(0, 0, this.width, this.height);
    view.raster(world, raster, [0, 0, 0], episode.about.floor);
    for (let k = 0; k < segments.length; k += 4) {
      const [x0, y0, x1, y1] = segments.subarray(k, k + 4);
      view.line(world, [[x0, y0], [x1, y1]], colors.wall, 2);
    }
    for (let k = 0; k < circles.length; k += 3) {
      view.disc(world, circles[k], circles[k + 1], circles[k + 2], colors.wall, 2);
    }
  }

  /** Draw ground truth; without a map also the estimated pose. */
  drawTruth(sample, pose, estimate, showsScan) {
    const { episode, colors, view } = this, context = prepare(this.truth);
    context.drawImage(this.world, 0, 0, this.width, this.height);
    if (showsScan) this.drawScan(context, sample);
    for (let k = 0; k < episode.people_radii.length; k++) {
      const first = 4 * (sample * episode.people_radii.length + k);
      const [x, y, vx, vy] = episode.people.subarray(first, first + 4);
      view.line(context, [[x, y], [x + vx, y + vy]], colors.person, 2);
      view.disc(context, x, y, episode.people_radii[k], colors.person, 3);
      if (episode.bodies[k] === "blind") view.cross(context, x, y, episode.people_radii[k], colors.paper);
    }
    this.drawTask(context, sample);
    if (!this.map) this.drawEstimates(context, sample, estimate);
    view.path(context, episode.true_poses, sample, pose, colors.true, 2);
    view.robot(context, pose, episode.about.radius, colors.true, colors.paper);
  }

  /** Draw route and goal, if any. */
  drawTask(context, sample) {
    const { colors, view, episode } = this, goal = episode.goal(sample);
    view.line(context, episode.worldRoute, colors.goal, 2);
    if (!goal) return;
    view.disc(context, ...goal, 0, colors.goal, 8);
    view.disc(context, ...goal, 0, colors.paper, 5);
    view.disc(context, ...goal, 0, colors.goal, 2.5);
  }

  /** Draw the area covered by the last scan, from the pose of the scan. */
  drawScan(context, sample) {
    const { episode, colors, view } = this, { lidar } = episode.about;
    const pose = episode.true_poses.subarray(3 * sample, 3 * sample + 3);
    const sensor = compose(pose, ...lidar.mount), unit = lidar.range_max / episode.rangeSteps;
    const outline = lidar.is_full_turn ? [] : [[sensor[0], sensor[1]]];
    const hits = [];
    lidar.angles.forEach((angle, k) => {
      const step = episode.scans[sample * episode.numBeams + k], isHit = step !== episode.noReturn && step > 0;
      const range = Math.min(step, episode.rangeSteps) * unit;
      const end = compose(sensor, range * Math.cos(angle), range * Math.sin(angle));
      outline.push(end);
      if (isHit) hits.push(end);
    });
    context.beginPath();
    for (const [x, y] of outline) context.lineTo(...view.at(x, y));
    context.fillStyle = colors.lidar;
    context.globalAlpha = 0.28;
    context.fill();
    context.globalAlpha = 1;
    for (const [x, y] of hits) view.disc(context, x, y, 0, colors.lidar, 1.7);
  }

  drawMap(sample, pose, truePose) {
    const { episode, colors, view, image } = this, context = prepare(this.map), { radius } = episode.about;
    context.fillStyle = colors.unknown;
    context.fillRect(0, 0, this.width, this.height);
    view.raster(context, image, episode.about.start, episode.about.map);
    this.drawTask(context, sample);
    this.drawMarkers(context);
    this.drawEstimates(context, sample, pose);
    this.drawCandidates(context);
    view.robot(context, pose, radius, colors.estimated, colors.paper);
    view.robot(context, truePose, radius, colors.true, colors.paper, true);
  }

  /** Draw the estimated path, the plan and tracked people. */
  drawEstimates(context, sample, pose) {
    const { episode, colors, view } = this;
    if (this.showsPath) view.path(context, episode.worldPoses, sample, pose, colors.estimated, 2);
    view.line(context, episode.plan(sample), colors.plan, 2.5, [6, 4]);
    for (const { at, ahead, radius } of episode.tracksAt(sample)) {
      view.ring(context, ...at, radius, this.map ? colors.person : colors.estimated);
      view.line(context, [at, ahead], this.map ? colors.person : colors.estimated, 2);
    }
  }

  /** Draw predicted floor, tour, random trees, found points, and goals without scores, the chosen ones filled. */
  drawMarkers(context) {
    const { colors, view, markers } = this, of = (kind) => markers.filter((one) => one.kind === kind);
    for (const { ends: [[x, y]], probability, side } of of(PREDICTED)) {
      context.globalAlpha = probability;
      view.disc(context, x, y, side / 2, colors.predicted, 1);
    }
    context.globalAlpha = 1;
    for (const [kind, color] of [[TOUR, colors.tour], [GLOBAL_TREE, colors.global], [LOCAL_TREE, colors.local]]) {
      for (const { ends } of of(kind)) view.line(context, ends, color, 1.4);
    }
    for (const { ends: [[x, y]] } of of(POINT)) view.disc(context, x, y, 0, colors.local, 2.5);
    for (const [kind, rim, fill] of [[CLUSTER, colors.frontier, colors.paper], [CHOSEN, colors.paper, colors.plan]]) {
      for (const { ends: [[x, y]] } of of(kind)) {
        view.disc(context, x, y, 0, rim, kind === CHOSEN ? 8 : 5.5);
        view.disc(context, x, y, 0, fill, kind === CHOSEN ? 6.5 : 3.5);
      }
    }
  }

  /** Draw candidates: size by score, the chosen one filled, scores next to the best ones. */
  drawCandidates(context) {
    const { colors, view, candidates } = this, taken = [];
    context.font = "600 12px system-ui, sans-serif";
    context.textBaseline = "middle";
    for (let k = candidates.length - 1; k >= 0; k--) {
      const { x, y, isChosen } = candidates[k], [left, top] = view.at(x, y);
      context.beginPath();
      context.arc(left, top, candidates[k].isChosen ? 8 : Math.max(4, 7 - 0.5 * k), 0, 2 * Math.PI);
      context.lineWidth = 2;
      context.fillStyle = isChosen ? colors.plan : colors.paper;
      context.strokeStyle = isChosen ? colors.paper : colors.frontier;
      context.fill();
      context.stroke();
    }
    for (const { x, y, score } of candidates.slice(0, LABELS)) {
      if (Number.isNaN(score)) continue;
      const text = score.toFixed(2), width = context.measureText(text).width, [left, top] = view.at(x, y);
      const start = left + 11 + width < this.width ? left + 11 : left - 11 - width;
      const box = [start - 3, top - 9, start + width + 3, top + 9];
      if (taken.some((b) => box[0] < b[2] && b[0] < box[2] && box[1] < b[3] && b[1] < box[3])) continue;
      taken.push(box);
      context.globalAlpha = 0.8;
      context.fillStyle = colors.paper;
      context.fillRect(box[0], box[1], box[2] - box[0], box[3] - box[1]);
      context.globalAlpha = 1;
      context.fillStyle = colors.ink;
      context.fillText(text, start, top);
    }
  }

  /** Show the tooltip of the candidate under the pointer. */
  point(event) {
    const away = this.candidates.map(({ x, y }) => {
      const [left, top] = this.view.at(x, y);
      return Math.hypot(left - event.offsetX, top - event.offsetY);
    });
    const nearest = away.indexOf(Math.min(...away));
    this.tip.hidden = !(away[nearest] <= TIP_REACH);
    if (this.tip.hidden) return;
    const candidate = this.candidates[nearest], [left, top] = this.view.at(candidate.x, candidate.y);
    this.tip.textContent = describeCandidate(candidate);
    this.tip.style.left = `${Math.max(0, Math.min(left, this.width - this.tip.offsetWidth))}px`;
    this.tip.style.top = `${top + 14 + this.tip.offsetHeight < this.height ? top + 20 : top - 8 - this.tip.offsetHeight}px`;
  }

  /** Repaint the map cells in [top, left, bottom, right] and their neighbors. */
  paint([top, left, bottom, right]) {
    const { episode, words, colors } = this, { kinds, rows, cols } = episode;
    const [free, occupied, frontier] = [colors.free, colors.occupied, colors.frontier].map(pixelOf);
    const [first, last] = [Math.max(0, left - 1), Math.min(cols - 1, right + 1)];
    for (let row = Math.max(0, top - 1); row <= Math.min(rows - 1, bottom + 1); row++) {
      for (let col = first; col <= last; col++) {
        const kind = kinds[row * cols + col];
        let pixel = 0; // unknown: transparent
        if (kind === OCCUPIED) pixel = occupied;
        else if (kind === FREE) pixel = episode.isFrontier(row, col) ? frontier : free;
        words[row * cols + col] = pixel;
      }
    }
    const y = Math.max(0, top - 1);
    this.imageContext.putImageData(this.pixels, 0, 0, first, y, last - first + 1, Math.min(rows, bottom + 2) - y);
  }
}

/** Return the tooltip of a candidate, one fact per line. */
function describeCandidate({ cost, visible, failures, score, isChosen }) {
  const lines = [`path ${cost.toFixed(1)} m`, `unknown in view ${visible.toFixed(1)} m²`];
  if (!Number.isNaN(score)) lines.unshift(`score ${score.toFixed(3)}`);
  if (failures) lines.push(`failed ${failures} times`);
  return `${isChosen ? "chosen\n" : ""}${lines.join("\n")}`;
}
