"""The search for cheapest paths over a costmap: A* to one goal, Dijkstra's algorithm to everywhere.

Lengths are integers, so that equal paths are equal exactly, ties break the same way everywhere, and a reference
implementation must agree to the last unit: a straight step over a free cell measures `70 * 16`, a diagonal one
`99 * 16` (99/70 is the root of two to 5e-5).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from lidarnaut.envs.navigation.costmap import COST_INSCRIBED, COST_LETHAL, COST_MAX_FREE, COST_UNKNOWN

STRAIGHT = 70
"""Length of a step to one of the four nearest cells."""
DIAGONAL = 99
"""Length of a step to one of the four next ones."""
SCALE = 16
"""Units into which the length of a step is divided, to weight it with costs."""
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, -1), (-1, 1))
"""Steps (rows, columns): the diagonal one with index `k + 4` lies between the straight ones `k` and `k + 1`."""
NO_STEP = 255
"""In place of the step into a cell that none leads into."""
ALL_STEPS = np.uint8(255)
"""A bit for each of `STEPS`."""
ONWARD = np.full(256, ALL_STEPS)
"""By the step that led into a cell, the bits of those that lead onward: that one, and of a diagonal one its parts."""
for _k in range(8):
    ONWARD[_k] = 1 << _k if _k < 4 else 1 << _k | 1 << (_k - 4) | 1 << ((_k - 3) & 3)
LOWEST_BIT = np.array([0, *((k & -k).bit_length() - 1 for k in range(1, 256))], dtype=np.uint8)
"""By a set of steps, a bit for each of `STEPS`: the first one in it."""
UNREACHED = np.int32(np.iinfo(np.int32).max)
"""Travel cost of cells that cannot be reached."""
NO_GOAL = (-1, -1)
"""In place of a goal, to search everywhere."""
COST_WEIGHT = 3.0
"""How many times its length a step over a free cell of the highest cost costs more than one over a free one."""
NUM_BUCKETS = 1 << 15
"""Buckets of the queue, a power of two; more than the estimated total can grow by from one cell to the next."""
BUCKET_SHIFT = 8
"""Without a goal a bucket holds 2**8 totals: fewer than any step is long, so that cells of one bucket cannot improve
each other (Dinic 1978). Otherwise most of the time would go into passing empty buckets."""
NUM_COARSE_BUCKETS = 1 << 7
"""Buckets that are used without a goal: more than a step is long, and few enough to stay in the nearest cache."""
MAX_COST_WEIGHT = 9.0
"""Greatest weight that may be asked for."""
ESCAPE_WEIGHT = 10.0
"""The same for cells where the footprint touches an obstacle; only a robot that is in them already crosses them.
Greater than any other, which is how the search tells them."""


def step_weights(cost_weight: float, allow_unknown: bool) -> np.ndarray:
    """Tabulate what a unit of length costs in a cell of each cost: shape (256,), uint8; 0 where no robot may go."""
    if not 0 <= cost_weight <= MAX_COST_WEIGHT:
        raise ValueError(f"cost_weight must lie in [0, {MAX_COST_WEIGHT}], got {cost_weight}")
    weights = np.zeros(256, dtype=np.uint8)
    costs = np.arange(COST_MAX_FREE + 1)
    weights[: COST_MAX_FREE + 1] = np.rint(SCALE * (1.0 + cost_weight * costs / COST_MAX_FREE))
    weights[COST_INSCRIBED] = round(SCALE * (1.0 + ESCAPE_WEIGHT))
    weights[COST_UNKNOWN] = weights[COST_MAX_FREE] if allow_unknown else 0
    return weights


@njit(cache=True, error_model="numpy", inline="always")
def octile(d_row, d_col):
    """Return the length of the shortest path over free cells."""
    d_row, d_col = abs(d_row), abs(d_col)
    return SCALE * (STRAIGHT * max(d_row, d_col) + (DIAGONAL - STRAIGHT) * min(d_row, d_col))


class Expansion(NamedTuple):
    """State of a search. Arrays over the raster are flat, with a border of one cell."""

    travel: np.ndarray
    """Shape ((height + 2) * (width + 2),), int32: travel costs, `UNREACHED` where the search has not come."""
    predecessor: np.ndarray
    """Same shape, uint8: index into `STEPS` of the step that led into a cell."""
    heads: np.ndarray
    """Shape (NUM_BUCKETS,), int32: first entry of each bucket of the queue, -1 for none."""
    counters: np.ndarray
    """Shape (4,), int64: level (total of the current bucket), number of entries so far, entries waiting in the queue,
    and whether the search started in a lethal cell."""


LEVEL, NUM_ENTRIES, NUM_WAITING, STARTS_INSIDE = range(4)


@njit(cache=True, error_model="numpy")
def new_expansion(height, width):
    """Return a search over a raster that has not begun."""
    size = (height + 2) * (width + 2)
    travel, predecessor = np.full(size, UNREACHED, dtype=np.int32), np.full(size, NO_STEP, dtype=np.uint8)
    return Expansion(travel, predecessor, np.full(NUM_BUCKETS, -1, dtype=np.int32), np.zeros(4, dtype=np.int64))


@njit(cache=True, error_model="numpy")
def begin(expansion, entries, costs, start, goal):
    """Start a search over at a cell, in time that grows with what the last one has reached; see `_expand`."""
    (row, col), stride = start, costs.shape[1] + 2
    starts_inside = costs[row, col] == COST_LETHAL
    level = octile(goal[0] - row, goal[1] - col) if goal[0] >= 0 else 0
    travel, predecessor, counters = expansion.travel, expansion.predecessor, expansion.counters
    for k in range(counters[NUM_ENTRIES]):
        node = np.uint32(entries[k, 0])
        travel[node] = UNREACHED
        predecessor[node] = NO_STEP
    expansion.heads[:] = -1
    node = np.uint32((row + 1) * stride + col + 1)
    travel[node] = 0
    entries[0, 0], entries[0, 1] = node, -1
    expansion.heads[level & (NUM_BUCKETS - 1)] = 0
    counters[LEVEL], counters[NUM_ENTRIES], counters[NUM_WAITING], counters[STARTS_INSIDE] = level, 1, 1, starts_inside


@njit(cache=True, error_model="numpy")
def _expand(expansion, entries, open_weights, stride, touching, goal, limit):
    """Search on until the goal is reached, or all cells that cost at most `limit`; return the next `counters`.

    A robot whose footprint touches something at the start may drive on through such cells, of weight `touching`, until
    it is out of them, and enters none again. Diagonal steps need both cells beside them open. The queue is Dial's
    (1969): a ring of buckets, one per estimated total, last in first out, so that ties go to the path that has come
    farthest. Where all cells around one cost the same, only steps that lead onward are tried: the pruning of jump point
    search (Harabor, Grastien, "Online graph pruning for pathfinding on grid maps", 2011). What the rest would find is
    found from the cell before, at no higher cost.

    `entries`: shape (n, 2), int32: of each entry of the queue its cell, and the next entry in its bucket; written, as
    is `expansion`; where it is full, the search stops early. `open_weights`: shape ((height + 2) * (width + 2),),
    uint8, 0 in the border; `stride`: width of the raster and its border; `goal`: (row, column) or `NO_GOAL`.
    """
    travel, predecessor, heads, counters = expansion.travel, expansion.predecessor, expansion.heads, expansion.counters
    goal_row, goal_col = goal
    has_goal = goal_row >= 0
    jumps = np.array([d_row * np.int64(stride) + d_col for d_row, d_col in STEPS])
    shift, mask = (0, NUM_BUCKETS - 1) if has_goal else (BUCKET_SHIFT, NUM_COARSE_BUCKETS - 1)
    level, num_entries, num_waiting = counters[LEVEL], np.uint64(counters[NUM_ENTRIES]), counters[NUM_WAITING]
    starts_inside = counters[STARTS_INSIDE] == 1
    # Indices are unsigned: signed ones might be negative, and each would be checked for it.
    right, up = np.uint64(1), np.uint64(stride)
    straight, diagonal = np.int32(STRAIGHT), np.int32(DIAGONAL)
    shut = np.int32(touching)
    row, col = np.int64(0), np.int64(0)
    # Room for eight more is left before a cell is expanded: an array that may change in the loop would slow it down.
    while num_waiting > 0 and np.int64(num_entries) + 8 <= entries.shape[0]:
        while heads[np.uint64(level & mask)] < 0:
            level += 1
        if level > limit >> shift:
            break
        bucket = np.uint64(level & mask)
        entry = np.uint64(heads[bucket])
        heads[bucket] = entries[entry, 1]
        num_waiting -= 1
        node = np.uint64(entries[entry, 0])
        here = travel[node]
        if has_goal:
            row, col = np.int64(node // up) - 1, np.int64(node % up) - 1
        if (here + (octile(row - goal_row, col - goal_col) if has_goal else 0)) >> shift != level:
            # A cheaper path has come to this cell since it was queued.
            continue
        if has_goal and row == goal_row and col == goal_col:
            break
        escaping = open_weights[node] == touching or (starts_inside and here == 0)
        a = np.int32(open_weights[node + right])
        b = np.int32(open_weights[node + up])
        c = np.int32(open_weights[node - right])
        d = np.int32(open_weights[node - up])
        ab = np.int32(open_weights[node + up + right])
        bc = np.int32(open_weights[node + up - right])
        cd = np.int32(open_weights[node - up - right])
        da = np.int32(open_weights[node - up + right])
        own = np.int32(open_weights[node])
        is_uniform = (a == own) & (b == own) & (c == own) & (d == own)
        is_uniform &= (ab == own) & (bc == own) & (cd == own) & (da == own)
        if not escaping:
            a, b, c, d = a * (a != shut), b * (b != shut), c * (c != shut), d * (d != shut)
            ab, bc, cd, da = ab * (ab != shut), bc * (bc != shut), cd * (cd != shut), da * (da != shut)
        # The steps that lead somewhere at less cost than before, as bits and without branches, which would often be
        # mispredicted.
        steps = ((a != 0) & (here + a * straight < travel[node + right])) * 1
        steps |= ((b != 0) & (here + b * straight < travel[node + up])) * 2
        steps |= ((c != 0) & (here + c * straight < travel[node - right])) * 4
        steps |= ((d != 0) & (here + d * straight < travel[node - up])) * 8
        steps |= ((a != 0) & (b != 0) & (ab != 0) & (here + ab * diagonal < travel[node + up + right])) * 16
        steps |= ((b != 0) & (c != 0) & (bc != 0) & (here + bc * diagonal < travel[node + up - right])) * 32
        steps |= ((c != 0) & (d != 0) & (cd != 0) & (here + cd * diagonal < travel[node - up - right])) * 64
        steps |= ((d != 0) & (a != 0) & (da != 0) & (here + da * diagonal < travel[node - up + right])) * 128
        steps &= ONWARD[predecessor[node]] if is_uniform else ALL_STEPS
        while steps:
            k = LOWEST_BIT[steps]
            steps &= steps - 1
            neighbour = np.uint64(np.int64(node) + jumps[k])
            there = here + np.int32(open_weights[neighbour]) * (straight if k < 4 else diagonal)
            travel[neighbour] = there
            predecessor[neighbour] = k
            if has_goal:
                d_row, d_col = STEPS[k]
                there += octile(row + d_row - goal_row, col + d_col - goal_col)
            bucket = np.uint64((there >> shift) & mask)
            entries[num_entries, 0], entries[num_entries, 1] = neighbour, heads[bucket]
            heads[bucket] = num_entries
            num_entries += right
            num_waiting += 1
    return level, np.int64(num_entries), num_waiting


@njit(cache=True, error_model="numpy")
def expand(expansion, entries, open_weights, costs, weights, goal, limit):
    """Go on with a search over costs; see `_expand`. Returns `entries`, or a larger array instead."""
    counters, stride, touching = expansion.counters, np.uint32(costs.shape[1] + 2), np.uint8(weights[COST_INSCRIBED])
    while True:
        # Written here, and not there: LLVM drops stores behind the loop of `_expand`.
        level, num_entries, num_waiting = _expand(expansion, entries, open_weights, stride, touching, goal, limit)
        counters[LEVEL], counters[NUM_ENTRIES], counters[NUM_WAITING] = level, num_entries, num_waiting
        if num_entries + 8 <= entries.shape[0]:
            return entries
        entries = np.concatenate((entries, np.empty_like(entries)))


@njit(cache=True, error_model="numpy")
def search(costs, weights, start_row, start_col, goal_row, goal_col):
    """Spread over costs, shape (height, width), uint8, from a start to a goal; everywhere if `goal_row` is negative.

    Returns travel costs, shape (height + 2, width + 2), int32, and the index into `STEPS` of the step that led to each
    cell, same shape, uint8; both with a border of one cell. They are final along the path to the goal.
    """
    height, width = costs.shape
    stride = np.uint32(width + 2)
    open_weights = np.zeros((height + 2) * (width + 2), dtype=np.uint8)
    for r in range(height):
        for c in range(width):
            open_weights[(r + 1) * stride + c + 1] = weights[costs[r, c]]
    expansion = new_expansion(height, width)
    entries = np.empty((open_weights.size, 2), dtype=np.int32)
    goal = goal_row, goal_col
    begin(expansion, entries, costs, (start_row, start_col), goal)
    expand(expansion, entries, open_weights, costs, weights, goal, np.int64(UNREACHED))
    return expansion.travel.reshape(height + 2, width + 2), expansion.predecessor.reshape(height + 2, width + 2)
