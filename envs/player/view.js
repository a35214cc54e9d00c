// Drawing on a canvas in world coordinates [m].

const WALL_MARGIN = 0.3; // around the walls [m]
const COLORS = [
  ..."ink muted line paper true estimated plan goal frontier lidar person floor outside wall free occupied".split(" "),
  ..."unknown contact first second global local predicted tour".split(" "),
];

/** Return the theme's colors by name. */
function themeColors() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(COLORS.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

/** Return a color such as #1d2129 as a pixel value. */
function pixelOf(color) {
  const value = parseInt(color.slice(1), 16);
  return (0xff000000 | ((value & 0xff) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}

/** Fit a canvas to its screen size; return its context in CSS pixels. */
function prepare(canvas, width = canvas.clientWidth, height = canvas.clientHeight) {
  const ratio = window.devicePixelRatio || 1;
  const size = [width, height].map((side) => Math.max(1, Math.round(side * ratio)));
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return context;
}

/** Return the bounding box of walls and cylinders with a margin: [x_min, y_min, x_max, y_max] [m]. */
function boundsOf({ segments, circles }) {
  const bounds = [Infinity, Infinity, -Infinity, -Infinity];
  const add = (x, y, radius) => {
    bounds[0] = Math.min(bounds[0], x - radius);
    bounds[1] = Math.min(bounds[1], y - radius);
    bounds[2] = Math.max(bounds[2], x + radius);
    bounds[3] = Math.max(bounds[3], y + radius);
  };
  for (let k = 0; k < segments.length; k += 2) add(segments[k], segments[k + 1], WALL_MARGIN);
  for (let k = 0; k < circles.length; k += 3) add(circles[k], circles[k + 1], circles[k + 2] + WALL_MARGIN);
  return bounds;
}

/** Part of the world on a canvas: uniform scale, y upwards, centered. */
class View {
  constructor([x0, y0, x1, y1], width, height) {
    this.scale = Math.min(width / (x1 - x0), height / (y1 - y0)); // pixels per metre
    this.left = (x0 + x1) / 2 - width / 2 / this.scale;
    this.top = (y0 + y1) / 2 + height / 2 / this.scale;
  }

  /** Return the canvas position of a world point [px]. */
  at(x, y) {
    return [(x - this.left) * this.scale, (this.top - y) * this.scale];
  }

  /** Draw a raster with the lowest y in its first row; `frame` is the world pose of its frame. */
  raster(context, image, frame, { resolution, origin }) {
    const [x, y] = this.at(...compose(frame, ...origin)), side = this.scale * resolution;
    const c = side * Math.cos(frame[2]), s = side * Math.sin(frame[2]);
    context.save();
    context.transform(c, -s, -s, -c, x, y);
    context.imageSmoothingEnabled = side * (window.devicePixelRatio || 1) < 1;
    context.drawImage(image, 0, 0);
    context.restore();
  }

  disc(context, x, y, radius, color, least = 0) {
    context.beginPath();
    context.arc(...this.at(x, y), Math.max(radius * this.scale, least), 0, 2 * Math.PI);
    context.fillStyle = color;
    context.fill();
  }

  /** Draw a diagonal cross within a circle. */
  cross(context, x, y, radius, color) {
    const [left, top] = this.at(x, y), reach = 0.5 * Math.max(radius * this.scale, 3);
    context.beginPath();
    for (const side of [-1, 1]) {
      context.moveTo(left - reach, top - side * reach);
      context.lineTo(left + reach, top + side * reach);
    }
    context.strokeStyle = color;
    context.lineWidth = Math.min(2, 0.6 * reach);
    context.stroke();
  }

  ring(context, x, y, radius, color) {
    context.beginPath();
    context.arc(...this.at(x, y), Math.max(radius * this.scale, 3), 0, 2 * Math.PI);
    context.strokeStyle = color;
    context.lineWidth = 2;
    context.stroke();
  }

  line(context, points, color, width, dashes = []) {
    if (points.length < 2) return;
    context.beginPath();
    for (const [x, y] of points) context.lineTo(...this.at(x, y));
    context.strokeStyle = color;
    context.lineWidth = width;
    context.lineJoin = "round";
    context.setLineDash(dashes);
    context.stroke();
    context.setLineDash([]);
  }

  /** Draw the path up to a sample and the current pose. */
  path(context, poses, sample, pose, color, width) {
    const points = [];
    for (let k = 0; k <= sample; k++) points.push([poses[3 * k], poses[3 * k + 1]]);
    this.line(context, [...points, pose], color, width);
  }

  /** Draw a robot with its heading, or its outline. */
  robot(context, pose, radius, color, headingColor, isGhost = false) {
    const [x, y] = this.at(pose[0], pose[1]), size = Math.max(radius * this.scale, 5);
    const tip = [x + 1.1 * size * Math.cos(pose[2]), y - 1.1 * size * Math.sin(pose[2])];
    context.strokeStyle = context.fillStyle = color;
    context.lineWidth = 2;
    context.beginPath();
    context.arc(x, y, size, 0, 2 * Math.PI);
    if (isGhost) return context.stroke();
    context.fill();
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(...tip);
    context.strokeStyle = headingColor;
    context.stroke();
  }
}
