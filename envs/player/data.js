// Decoding of recordings written by `pack` in page.py, and lookup by time.

const UNKNOWN = 0, FREE = 1, OCCUPIED = 2;
const VISIBLE_ERROR = 0.05; // least distance of estimated and true path that can be seen [m]
const CLUSTER = 0, CHOSEN = 1, POINT = 2, GLOBAL_TREE = 3, LOCAL_TREE = 4, PREDICTED = 5, TOUR = 6; // markers
const TYPES = { float32: Float32Array, int32: Int32Array, uint8: Uint8Array };

/** Decode the page's data into episodes. */
async function readEpisodes(base64) {
  const text = atob(base64.trim());
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const buffer = await new Response(stream).arrayBuffer();
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return header.episodes.map((one) => new Episode(one, buffer, 4 + length, header));
}

/** Return the number of elements of a sorted array that are at most a value. */
function countUpTo(values, value) {
  let low = 0, high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] <= value) low = middle + 1; else high = middle;
  }
  return low;
}

/** Transform a pose (x, y, heading) from a frame to the parent of `frame`. */
function compose(frame, x, y, heading = 0) {
  const c = Math.cos(frame[2]), s = Math.sin(frame[2]);
  return [frame[0] + c * x - s * y, frame[1] + s * x + c * y, frame[2] + heading];
}

class Episode {
  constructor({ about, arrays }, buffer, first, { rangeSteps, noReturn }) {
    Object.assign(this, { about, rangeSteps, noReturn });
    for (const [name, type, , offset, count] of arrays) {
      this[name] = new TYPES[type](buffer, first + offset, count);
    }
    const columns = Object.fromEntries(arrays.map(([name, , width]) => [name, width]));
    this.numBeams = columns.scans;
    this.candidateWidth = columns.candidates;
    this.floorWidth = columns.floor;
    for (let k = 1; k < this.map_cells.length; k++) this.map_cells[k] += this.map_cells[k - 1];
    this.count = this.time.length;
    this.end = this.time[this.count - 1];
    [this.rows, this.cols] = about.map.shape;
    this.kinds = new Uint8Array(this.rows * this.cols);
    this.mapSample = -1; // sample of `kinds`
    [this.markerSample, this.markerRow] = [-1, 0]; // sample of `shownMarkers`, and next row of `markers`
    this.shownMarkers = new Map();
    this.hasMap = this.map_cells.length > 0 || this.candidates.length > 0;
    // Kinds of people and other robots; "" if the recording does not tell them.
    this.bodies = about.bodies || Array(this.people_radii.length).fill("");
    this.worldPoses = new Float32Array(3 * this.count);
    this.errors = new Float32Array(this.count);
    this.worldRoute = [];
    for (let k = 0; k < this.route.length; k += 2) {
      this.worldRoute.push(compose(about.start, this.route[k], this.route[k + 1]));
    }
    for (let i = 0; i < this.count; i++) {
      const pose = compose(about.start, ...this.poses.subarray(3 * i, 3 * i + 3));
      this.worldPoses.set(pose, 3 * i);
      this.errors[i] = Math.hypot(pose[0] - this.true_poses[3 * i], pose[1] - this.true_poses[3 * i + 1]);
    }
  }

  /** Whether the estimated path can be told from the true one. */
  get isAstray() {
    return this.errors.some((error) => error > VISIBLE_ERROR);
  }

  /** Return the goal at a sample, world frame; null without a goal. */
  goal(i) {
    const [x, y] = this.goals.subarray(2 * i, 2 * i + 2);
    return Number.isNaN(x) ? null : compose(this.about.start, x, y).slice(0, 2);
  }

  /** Return the last sample at or before a time [s]. */
  sampleAt(time) {
    return Math.max(0, countUpTo(this.time, time) - 1);
  }

  /** Return the last decision at or before a time [s]; -1 before the first. */
  decisionAt(time) {
    return countUpTo(this.decision_times, time) - 1;
  }

  /** Return an interpolated pose of `true_poses` or `worldPoses` (world frame). */
  poseAt(poses, time) {
    const i = this.sampleAt(time), j = Math.min(i + 1, this.count - 1);
    const share = j > i ? Math.min(1, (time - this.time[i]) / (this.time[j] - this.time[i])) : 0;
    const turn = poses[3 * j + 2] - poses[3 * i + 2];
    const values = [0, 1].map((k) => poses[3 * i + k] + share * (poses[3 * j + k] - poses[3 * i + k]));
    return [...values, poses[3 * i + 2] + share * Math.atan2(Math.sin(turn), Math.cos(turn))];
  }

  /** Return the planned path at a sample, world frame. */
  plan(i) {
    const points = [];
    for (let k = i ? this.plan_ends[i - 1] : 0; k < this.plan_ends[i]; k++) {
      points.push(compose(this.about.start, this.plans[2 * k], this.plans[2 * k + 1]));
    }
    return points;
  }

  /** Return tracked people at a sample: positions now and in 1 s, world frame. */
  tracksAt(i) {
    const found = [];
    for (let k = i ? this.track_ends[i - 1] : 0; k < this.track_ends[i]; k++) {
      const [x, y, vx, vy, radius] = this.tracks.subarray(5 * k, 5 * k + 5);
      const at = compose(this.about.start, x, y).slice(0, 2);
      found.push({ at, ahead: compose(this.about.start, x + vx, y + vy).slice(0, 2), radius });
    }
    return found;
  }

  /** Return the candidates of a decision, world frame, sorted by descending score if scored. */
  candidatesOf(decision) {
    const found = [];
    if (decision < 0) return found;
    const begin = decision ? this.candidate_ends[decision - 1] : 0;
    for (let k = begin; k < this.candidate_ends[decision]; k++) {
      const [x, y, cost, visible, failures, score] = this.candidates.subarray(k * this.candidateWidth);
      const [worldX, worldY] = compose(this.about.start, x, y);
      const isChosen = k - begin === this.decision_chosen[decision];
      found.push({ x: worldX, y: worldY, cost, visible, failures, score, isChosen });
    }
    const rank = ({ score }) => (Number.isNaN(score) ? -Infinity : score); // those without a score are last
    return found.sort((a, b) => rank(b) - rank(a) || a.cost - b.cost);
  }

  /** Return the policy's markers at a sample: kind and both ends, world frame; probability and side of cells. */
  markersAt(i) {
    const { markers, about, shownMarkers: shown } = this;
    if (i < this.markerSample) {
      this.markerRow = 0;
      shown.clear();
    }
    // A row adds a marker, or removes it if it is shown.
    for (; markers[6 * this.markerRow] <= i; this.markerRow++) {
      const row = markers.subarray(6 * this.markerRow + 1, 6 * this.markerRow + 6), key = row.join();
      if (shown.delete(key)) continue;
      const [kind, x0, y0, x1, y1] = row;
      const ends = [compose(about.start, x0, y0), compose(about.start, x1, y1)];
      shown.set(key, { kind, ends, probability: x1, side: y1 }); // the last two of predicted cells
    }
    this.markerSample = i;
    return [...shown.values()];
  }

  /** Return whether a marker of a kind occurs. */
  hasMarker(wanted) {
    return this.markers.some((kind, k) => k % 6 === 1 && kind === wanted);
  }

  /** Update `kinds` to a sample; return the changed area [top, left, bottom, right], or null. */
  showMap(i) {
    const ends = this.map_ends, cols = this.cols;
    const from = Math.min(this.mapSample, i), to = Math.max(this.mapSample, i);
    let top = this.rows, left = cols, bottom = -1, right = -1;
    // Changes are exclusive ors: applying them twice undoes them.
    for (let k = from < 0 ? 0 : ends[from]; k < (to < 0 ? 0 : ends[to]); k++) {
      const cell = this.map_cells[k], row = (cell / cols) | 0, col = cell - row * cols;
      this.kinds[cell] ^= this.map_changes[k];
      if (row < top) top = row;
      if (row > bottom) bottom = row;
      if (col < left) left = col;
      if (col > right) right = col;
    }
    this.mapSample = i;
    return bottom < 0 ? null : [top, left, bottom, right];
  }

  /** Return whether the first or the last map has frontier cells. */
  hasFrontier() {
    const before = this.mapSample;
    const found = [0, this.count - 1].some((i) => {
      this.showMap(i);
      return this.kinds.some((kind, cell) => {
        const row = (cell / this.cols) | 0;
        return kind === FREE && this.isFrontier(row, cell - row * this.cols);
      });
    });
    this.showMap(before);
    return found;
  }

  /** Return true if a free cell has an unknown neighbor (8-connected). */
  isFrontier(row, col) {
    for (let r = row - 1; r <= row + 1; r++) {
      for (let c = col - 1; c <= col + 1; c++) {
        const isInside = r >= 0 && c >= 0 && r < this.rows && c < this.cols;
        if (!isInside || this.kinds[r * this.cols + c] === UNKNOWN) return true;
      }
    }
    return false;
  }
}
