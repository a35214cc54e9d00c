// Plots over time with a cursor at the current time.

const PLOT = { left: 44, right: 10, top: 22, bottom: 22 }; // borders [px]
const STEPS = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600];

/** Return a time as 1:02:03 or 2:03. */
function clockText(seconds) {
  const whole = Math.floor(seconds + 1e-6), minutes = Math.floor(whole / 60);
  const two = (value) => String(value).padStart(2, "0");
  const rest = two(whole % 60);
  return minutes < 60 ? `${minutes}:${rest}` : `${Math.floor(minutes / 60)}:${two(minutes % 60)}:${rest}`;
}

/** Round a positive value up to 1, 2 or 5 times a power of ten. */
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((factor) => factor * power).find((round) => round >= value * (1 - 1e-9));
}

class Plot {
  /** `valuesOf(episode)` returns one value per sample; `onSeek(time)` is called on pointer input. */
  constructor(canvas, title, episodes, valuesOf, end, onSeek) {
    Object.assign(this, { canvas, title, episodes, end, series: episodes.map(valuesOf) });
    const greatest = this.series.reduce((most, values) => values.reduce((a, b) => Math.max(a, b), most), 0);
    this.limit = roundUp(Math.max(greatest, 1e-3));
    this.still = document.createElement("canvas");
    const seek = (event) => onSeek(((event.offsetX - PLOT.left) / this.width) * end);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) seek(event);
    });
  }

  /** Draw axes and curves for the current size and theme. */
  layout() {
    const { canvas } = this, colors = (this.colors = themeColors());
    this.width = canvas.clientWidth - PLOT.left - PLOT.right;
    this.height = canvas.clientHeight - PLOT.top - PLOT.bottom;
    const context = prepare(this.still, canvas.clientWidth, canvas.clientHeight);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = colors.ink;
    context.textAlign = "left";
    context.fillText(this.title, 4, 13);
    context.strokeStyle = colors.line;
    context.fillStyle = colors.muted;
    context.lineWidth = 1;
    for (const share of [0, 0.5, 1]) {
      const y = this.y(share * this.limit);
      this.stroke(context, [[PLOT.left, y], [PLOT.left + this.width, y]]);
      context.textAlign = "right";
      context.fillText(String(+(share * this.limit).toPrecision(3)), PLOT.left - 6, y + 4);
    }
    const step = STEPS.find((one) => this.end / one <= this.width / 56) || STEPS[STEPS.length - 1];
    context.textAlign = "center";
    for (let time = 0; time <= this.end; time += step) {
      this.stroke(context, [[this.x(time), PLOT.top], [this.x(time), PLOT.top + this.height]]);
      context.fillText(clockText(time), Math.min(this.x(time), canvas.clientWidth - 14), PLOT.top + this.height + 15);
    }
    this.episodes.forEach((episode, k) => this.drawCurve(context, episode, k));
  }

  drawCurve(context, episode, k) {
    const values = this.series[k], step = Math.max(1, Math.floor(episode.count / (2 * this.width)));
    context.strokeStyle = this.colors[k ? "second" : "first"];
    context.lineWidth = 2;
    const points = [];
    for (let i = 0; i < episode.count; i += step) points.push([this.x(episode.time[i]), this.y(values[i])]);
    points.push([this.x(episode.end), this.y(values[episode.count - 1])]);
    this.stroke(context, points, k ? [6, 3] : []);
    context.fillStyle = this.colors.contact;
    for (let i = 1; i < episode.count; i++) {
      if (episode.contacts[i] > episode.contacts[i - 1]) {
        context.fillRect(this.x(episode.time[i]) - 1, PLOT.top + this.height - 7, 2, 7);
      }
    }
  }

  /** Move the cursor to a time [s]. */
  draw(time) {
    const context = prepare(this.canvas), { clientWidth: width, clientHeight: height } = this.canvas;
    context.clearRect(0, 0, width, height);
    context.drawImage(this.still, 0, 0, width, height);
    context.strokeStyle = this.colors.ink;
    context.lineWidth = 1;
    this.stroke(context, [[this.x(time), PLOT.top], [this.x(time), PLOT.top + this.height]]);
    this.episodes.forEach((episode, k) => {
      const i = episode.sampleAt(time);
      context.beginPath();
      context.arc(this.x(Math.min(time, episode.end)), this.y(this.series[k][i]), 4, 0, 2 * Math.PI);
      context.fillStyle = this.colors[k ? "second" : "first"];
      context.fill();
    });
  }

  x(time) {
    return PLOT.left + (time / Math.max(this.end, 1e-6)) * this.width;
  }

  y(value) {
    return PLOT.top + (1 - value / this.limit) * this.height;
  }

  stroke(context, points, dashes = []) {
    context.setLineDash(dashes);
    context.beginPath();
    for (const [x, y] of points) context.lineTo(x, y);
    context.stroke();
    context.setLineDash([]);
  }
}
