// Draw a map with ros2d, and compose poses with roslib: reads {map, transforms, pose}, messages as plain data.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import vm from "node:vm";
import * as ROSLIB from "roslib";

const given = JSON.parse(readFileSync(0, "utf8"));
const pixels = { width: 0, height: 0, data: [] };
const canvas = {
  getContext: () => ({
    createImageData: (width, height) => ({ width, height, data: new Uint8ClampedArray(4 * width * height) }),
    putImageData: (image) => Object.assign(pixels, image),
  }),
};
function shape() { this.x = 0; this.y = 0; }  // of createjs: ros2d only sets position and scale
const createjs = { Bitmap: shape, Shape: shape, Container: shape, Stage: shape };
const eventemitter = function () {};
const context = vm.createContext({ document: { createElement: () => canvas }, createjs, ROSLIB, EventEmitter2: eventemitter, EventEmitter3: eventemitter, console });
const source = createRequire(import.meta.url).resolve("ros2d/build/ros2d.js");
vm.runInContext(readFileSync(source, "utf8"), context);
context.message = given.map;
const drawn = vm.runInContext("new ROS2D.OccupancyGrid({ message })", context);
const grey = Array.from({ length: pixels.width * pixels.height }, (_, k) => pixels.data[4 * k]);
const pose = new ROSLIB.Pose(given.pose);
for (const transform of given.transforms) pose.applyTransform(new ROSLIB.Transform(transform));
console.log(JSON.stringify({ width: pixels.width, height: pixels.height, grey, x: drawn.x, y: drawn.y, scale: drawn.scaleX, pose }));
