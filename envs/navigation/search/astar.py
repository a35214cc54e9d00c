"""Path search on a costmap: A* to one goal, or Dijkstra's algorithm to all cells.

Path costs are integers, for reproducible results. A straight step over a free cell costs `70 * 16`, a diagonal step `99
* 16`.
"""

from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.navigation.maps.costmap import COST_INSCRIBED, COST_LETHAL, COST_MAX_FREE, COST_UNKNOWN

STRAIGHT = 70
"""Integer length of a straight grid step; `DIAGONAL / STRAIGHT` approximates the square root of two."""
DIAGONAL = 99
SCALE = 16
"""Integer weight of a free cell. The cost of a step is its length times the weight of the entered cell."""
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""Moves to the eight neighbours (row, column). Diagonal move `k + 4` combines straight moves `k` and `(k + 1) % 4`."""
NO_STEP = 255
ALL_STEPS = np.uint8(255)
ONWARD = np.full(256, ALL_STEPS)
for _k in range(8):
    ONWARD[_k] = 1 << _k if _k < 4 else 1 << _k | 1 << (_k - 4) | 1 << ((_k - 3) & 3)
LOWEST_BIT = np.array([0, *((k & -k).bit_length() - 1 for k in range(1, 256))], dtype=np.uint8)
UNREACHED = np.int32(np.iinfo(np.int32).max)
NO_GOAL = (-1, -1)
COST_WEIGHT = 3.0
"""Weight of traversal costs in path search: cells of cost `COST_MAX_FREE` cost 1 + 3 times as much as free cells."""
NUM_BUCKETS = 1 << 15
"""Number of queue buckets of A*: a power of two, above the largest cost increase per step."""
BUCKET_SHIFT = 8
"""Right shift from a path cost to its bucket in Dijkstra's queue. A bucket is narrower than any step (Dinic 1978)."""
NUM_COARSE_BUCKETS = 1 << 7
"""Number of buckets in Dijkstra's queue: enough for the longest step, few enough for the L1 cache."""
ESCAPE_WEIGHT = 10.0
"""Additional weight of cells in collision relative to free cells, for paths that start in collision."""


def step_weights(cost_weight: float, allow_unknown: bool) -> np.ndarray:
    """Return the weight of each costmap value in path search, shape (256,), uint8; 0 if not traversable.

    `cost_weight`: relative extra cost, 0 to 9, of traversable cells next to obstacles.
    """
    weights = np.zeros(256, dtype=np.uint8)
    costs = np.arange(COST_MAX_FREE + 1)
    weights[: COST_MAX_FREE + 1] = np.rint(SCALE * (1.0 + cost_weight * costs / COST_MAX_FREE))
    weights[COST_INSCRIBED] = round(SCALE * (1.0 + ESCAPE_WEIGHT))
    weights[COST_UNKNOWN] = weights[COST_MAX_FREE] if allow_unknown else 0
    return weights


@njit(cache=True, error_model="numpy", inline="always")
def octile(d_row, d_col):
    """Return the integer cost of the shortest path over free cells (octile distance)."""
    d_row, d_col = abs(d_row), abs(d_col)
    return SCALE * (STRAIGHT * max(d_row, d_col) + (DIAGONAL - STRAIGHT) * min(d_row, d_col))


class Expansion(NamedTuple):
    """State of a grid search. Rasters are flat with a border of one cell."""

    travel: np.ndarray
    """Path cost from the start to each cell, int32; `UNREACHED` for unvisited cells."""
    predecessor: np.ndarray
    """Last move of the path to each cell, uint8: index into the eight moves of `STEPS`."""
    heads: np.ndarray
    """Index of the first entry in each queue bucket, int32; -1 if empty."""
    counters: np.ndarray


LEVEL, NUM_ENTRIES, NUM_WAITING, STARTS_INSIDE = range(4)


@njit(cache=True, error_model="numpy")
def new_expansion(height, width):
    """Allocate the state of a grid search on `height` x `width` cells."""
    size = (height + 2) * (width + 2)
    travel, predecessor = np.full(size, UNREACHED, dtype=np.int32), np.full(size, NO_STEP, dtype=np.uint8)
    return Expansion(travel, predecessor, np.full(NUM_BUCKETS, -1, dtype=np.int32), np.zeros(4, dtype=np.int64))


@njit(cache=True, error_model="numpy")
def begin(expansion, queue, costs, start, goal):
    """Start a new search, reusing the arrays of the previous search.

    `costs`: costmap, shape (height, width), uint8. `start`, `goal`: (row, column); `goal` may be `NO_GOAL`.
    """
    (row, col), stride = start, costs.shape[1] + 2
    starts_inside = costs[row, col] == COST_LETHAL
    level = octile(goal[0] - row, goal[1] - col) if goal[0] >= 0 else 0
    travel, predecessor, counters = expansion.travel, expansion.predecessor, expansion.counters
    for k in range(counters[NUM_ENTRIES]):
        node = np.uint32(queue[k, 0])
        travel[node] = UNREACHED
        predecessor[node] = NO_STEP
    expansion.heads[:] = -1
    node = np.uint32((row + 1) * stride + col + 1)
    travel[node] = 0
    queue[0, 0], queue[0, 1] = node, -1
    expansion.heads[level & (NUM_BUCKETS - 1)] = 0
    counters[LEVEL], counters[NUM_ENTRIES], counters[NUM_WAITING], counters[STARTS_INSIDE] = level, 1, 1, starts_inside


@njit(cache=True, error_model="numpy", inline="always")
def _cheaper_steps(travel, open_weights, node, up, touching, may_touch):
    """Return the steps that lower a neighbour's path cost, as bits, and whether all nine cells have the same weight.

    `up`: index step to the next row. `may_touch`: whether steps may enter cells in collision, of weight `touching`.
    """
    right, here, own, shut = np.uint64(1), travel[node], np.int32(open_weights[node]), np.int32(touching)
    straight, diagonal = np.int32(STRAIGHT), np.int32(DIAGONAL)
    a = np.int32(open_weights[node + right])
    b = np.int32(open_weights[node + up])
    c = np.int32(open_weights[node - right])
    d = np.int32(open_weights[node - up])
    ab = np.int32(open_weights[node + up + right])
    bc = np.int32(open_weights[node + up - right])
    cd = np.int32(open_weights[node - up - right])
    da = np.int32(open_weights[node - up + right])
    is_uniform = (a == own) & (b == own) & (c == own) & (d == own)
    is_uniform &= (ab == own) & (bc == own) & (cd == own) & (da == own)
    if not may_touch:
        a, b, c, d = a * (a != shut), b * (b != shut), c * (c != shut), d * (d != shut)
        ab, bc, cd, da = ab * (ab != shut), bc * (bc != shut), cd * (cd != shut), da * (da != shut)
    # Bits, because branches would be mispredicted.
    steps = ((a != 0) & (here + a * straight < travel[node + right])) * 1
    steps |= ((b != 0) & (here + b * straight < travel[node + up])) * 2
    steps |= ((c != 0) & (here + c * straight < travel[node - right])) * 4
    steps |= ((d != 0) & (here + d * straight < travel[node - up])) * 8
    steps |= ((a != 0) & (b != 0) & (ab != 0) & (here + ab * diagonal < travel[node + up + right])) * 16
    steps |= ((b != 0) & (c != 0) & (bc != 0) & (here + bc * diagonal < travel[node + up - right])) * 32
    steps |= ((c != 0) & (d != 0) & (cd != 0) & (here + cd * diagonal < travel[node - up - right])) * 64
    steps |= ((d != 0) & (a != 0) & (da != 0) & (here + da * diagonal < travel[node - up + right])) * 128
    return steps, is_uniform


@njit(cache=True, error_model="numpy")
def _expand(expansion, queue, open_weights, stride, touching, goal, limit):
    """Continue a grid search until the goal or the path cost `limit` is reached, or the queue is full.

    A path that starts in collision may cross cells in collision until it first leaves them. Diagonal steps require both
    adjacent straight cells to be open. The queue is Dial's (1969) ring of buckets. Moves between cells of equal weight
    are pruned after Harabor, Grastien, "Online graph pruning for pathfinding on grid maps" (2011).
    """
    travel, predecessor, heads, counters = expansion.travel, expansion.predecessor, expansion.heads, expansion.counters
    goal_row, goal_col = goal
    has_goal = goal_row >= 0
    jumps = np.array([d_row * np.int64(stride) + d_col for d_row, d_col in STEPS])
    shift, mask = (0, NUM_BUCKETS - 1) if has_goal else (BUCKET_SHIFT, NUM_COARSE_BUCKETS - 1)
    level, num_entries, num_waiting = counters[LEVEL], np.uint64(counters[NUM_ENTRIES]), counters[NUM_WAITING]
    starts_inside = counters[STARTS_INSIDE] == 1
    # Unsigned indices avoid checks for negative indices.
    up = np.uint64(stride)
    row, col = np.int64(0), np.int64(0)
    # Eight entries must be free: growing an array in the loop would be slow.
    while num_waiting > 0 and np.int64(num_entries) + 8 <= queue.shape[0]:
        while heads[np.uint64(level & mask)] < 0:
            level += 1
        if level > limit >> shift:
            break
        bucket = np.uint64(level & mask)
        entry = np.uint64(heads[bucket])
        heads[bucket] = queue[entry, 1]
        num_waiting -= 1
        node = np.uint64(queue[entry, 0])
        here = travel[node]
        if has_goal:
            row, col = np.int64(node // up) - 1, np.int64(node % up) - 1
        if (here + (octile(row - goal_row, col - goal_col) if has_goal else 0)) >> shift != level:
            continue  # outdated: a cheaper path has reached the cell
        if has_goal and row == goal_row and col == goal_col:
            break
        escaping = open_weights[node] == touching or (starts_inside and here == 0)
        steps, is_uniform = _cheaper_steps(travel, open_weights, node, up, touching, escaping)
        steps &= ONWARD[predecessor[node]] if is_uniform else ALL_STEPS
        while steps:
            k = LOWEST_BIT[steps]
            steps &= steps - 1
            neighbour = np.uint64(np.int64(node) + jumps[k])
            there = here + np.int32(open_weights[neighbour]) * np.int32(STRAIGHT if k < 4 else DIAGONAL)
            travel[neighbour] = there
            predecessor[neighbour] = k
            if has_goal:
                d_row, d_col = STEPS[k]
                there += octile(row + d_row - goal_row, col + d_col - goal_col)
            bucket = np.uint64((there >> shift) & mask)
            queue[num_entries, 0], queue[num_entries, 1] = neighbour, heads[bucket]
            heads[bucket] = num_entries
            num_entries += np.uint64(1)
            num_waiting += 1
    return level, np.int64(num_entries), num_waiting


@njit(cache=True, error_model="numpy")
def expand(expansion, queue, open_weights, costs, weights, goal, limit):
    """Continue a grid search until the goal or the path cost `limit` is reached; return the queue, enlarged if full."""
    counters, stride, touching = expansion.counters, np.uint32(costs.shape[1] + 2), np.uint8(weights[COST_INSCRIBED])
    while True:
        # Written here: LLVM drops stores after the loop of `_expand`.
        level, num_entries, num_waiting = _expand(expansion, queue, open_weights, stride, touching, goal, limit)
        counters[LEVEL], counters[NUM_ENTRIES], counters[NUM_WAITING] = level, num_entries, num_waiting
        if num_entries + 8 <= queue.shape[0]:
            return queue
        queue = np.concatenate((queue, np.empty_like(queue)))


@njit(cache=True, error_model="numpy")
def search(costs, weights, start_row, start_col, goal_row, goal_col):
    """Search from a start cell to a goal cell, or to all cells if `goal_row` is negative.

    `costs`: costmap, shape (height, width), uint8. Returns the path cost to each cell, int32, and the last move of each
    path, uint8 index into `STEPS`, with a border of one cell. With a goal, only cells on the path are final.
    """
    height, width = costs.shape
    stride = np.uint32(width + 2)
    open_weights = np.zeros((height + 2) * (width + 2), dtype=np.uint8)
    for r in range(height):
        for c in range(width):
            open_weights[(r + 1) * stride + c + 1] = weights[costs[r, c]]
    expansion = new_expansion(height, width)
    queue = np.empty((open_weights.size, 2), dtype=np.int32)
    goal = goal_row, goal_col
    begin(expansion, queue, costs, (start_row, start_col), goal)
    expand(expansion, queue, open_weights, costs, weights, goal, np.int64(UNREACHED))
    return expansion.travel.reshape(height + 2, width + 2), expansion.predecessor.reshape(height + 2, width + 2)
