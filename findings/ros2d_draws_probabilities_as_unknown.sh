#!/usr/bin/env bash
# ros2d 0.10.0: of an occupancy grid, only the values 0 and 100 are drawn; all between them look like unknown cells.
#
# `nav_msgs/OccupancyGrid` holds percentages from 0 to 100, and -1 for unknown. Maps with probabilities (Cartographer), and
# costmaps, have most values between: 1 (free with 99 %) and 99 get the same grey, 127, as -1. RViz shades them. The yaw of
# the map's origin is read and not used: the position is that of a map without rotation. A program that shows such maps
# thresholds them first.
#
# Seen: {"grey": {"-1": 127, "0": 255, "1": 127, "50": 127, "99": 127, "100": 0}, "rotation": "none"}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
echo '{"private": true, "type": "module"}' > package.json
npm install --silent --no-audit --no-fund --ignore-scripts ros2d@0.10.0 roslib@2.1.0
cat > draw.mjs <<'JS'
import { readFileSync } from "node:fs";
import vm from "node:vm";
import * as ROSLIB from "roslib";

let pixels;
const canvas = {
  getContext: () => ({
    createImageData: (width, height) => ({ data: new Uint8ClampedArray(4 * width * height) }),
    putImageData: (image) => { pixels = image.data; },
  }),
};
// The classes of createjs only keep what ros2d assigns to them.
class Shape { rotation = 0; }
function Bitmap() { this.x = 0; this.y = 0; this.rotation = 0; }
const createjs = { Bitmap, Shape, Container: Shape, Stage: Shape };
const document = { createElement: () => canvas };
const values = [-1, 0, 1, 50, 99, 100];
const half = Math.SQRT1_2; // a quarter turn about z
const origin = { position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: half, w: half } };
const message = { info: { width: values.length, height: 1, resolution: 0.05, origin }, data: values };
const context = vm.createContext({ createjs, document, ROSLIB, EventEmitter2: Shape, EventEmitter3: Shape, message });
vm.runInContext(readFileSync("node_modules/ros2d/build/ros2d.js", "utf8"), context);
const drawn = vm.runInContext("new ROS2D.OccupancyGrid({ message })", context);
const grey = Object.fromEntries(values.map((value, k) => [String(value), pixels[4 * k]]));
const found = JSON.stringify({ grey, rotation: drawn.rotation === 0 ? "none" : drawn.rotation });
console.log(found);
const expected = { "-1": 127, 0: 255, 1: 127, 50: 127, 99: 127, 100: 0 };
const isSame = values.every((value) => grey[value] === expected[value]) && drawn.rotation === 0;
process.exit(isSame ? 0 : 1);
JS
node draw.mjs
