// Draw a map with ros2d, and compose poses with roslib: reads {map, transforms, pose}, messages as plain data.
import { readFileSync } from "node:fs";
import vm from "node:vm";
import * as ROSLIB from "roslib";

const given = JSON.parse(readFileSync(0, "utf8"));
const pixels = { width: 0, height: 0, data: [] };
const createImageData = (width, height) => ({ width, height, data: new Uint8ClampedArray(4 * width * height) });
const canvas = { getContext: () => ({ createImageData, putImageData: (image) => Object.assign(pixels, image) }) };
function shape() { this.x = 0; this.y = 0; }  // of createjs: ros2d only sets position and scale
const createjs = { Bitmap: shape, Shape: shape, Container: shape, Stage: shape };
const globals = { document: { createElement: () => canvas }, createjs, ROSLIB, console, message: given.map };
const context = vm.createContext({ ...globals, EventEmitter2: shape, EventEmitter3: shape });
vm.runInContext(readFileSync(new URL(import.meta.resolve("ros2d/build/ros2d.js")), "utf8"), context);
const drawn = vm.runInContext("new ROS2D.OccupancyGrid({ message })", context);
const grey = Array.from({ length: pixels.width * pixels.height }, (_, k) => pixels.data[4 * k]);
const pose = new ROSLIB.Pose(given.pose);
for (const transform of given.transforms) pose.applyTransform(new ROSLIB.Transform(transform));
console.log(JSON.stringify({ grey, x: drawn.x, y: drawn.y, pose }));
