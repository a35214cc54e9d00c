"""The search for cheapest ways over a costmap: A* to one goal, Dijkstra's to everywhere.

Lengths are integers, so that equal ways are equal exactly, ties break the same way everywhere, and a reference
implementation must agree to the last unit: a straight step over a free cell measures `70 * 16`, a diagonal one
`99 * 16` (99/70 is the root of two to 5e-5).
"""

import numpy as np
from numba import njit

from envs.navigation.costmap import COST_INSCRIBED, COST_LETHAL, COST_MAX_FREE, COST_UNKNOWN

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
UNREACHED = np.int32(np.iinfo(np.int32).max)
"""Travel cost of cells that cannot be reached."""
COST_WEIGHT = 3.0
"""How many times its length a step over the dearest free cell costs more than one over a free one."""
NUM_BUCKETS = 1 << 15
"""Buckets of the queue; more than the estimated total can grow by from one cell to the next."""
ESCAPE_WEIGHT = 10.0
"""The same for cells where the footprint touches an obstacle; only a robot that stands in them already crosses them."""


def step_weights(cost_weight: float, allow_unknown: bool) -> np.ndarray:
    """Tabulate what a unit of length costs in a cell of each cost: shape (256,), int32; 0 where no robot may go."""
    if not 0 <= cost_weight <= ESCAPE_WEIGHT:
        raise ValueError(f"cost_weight must lie in [0, {ESCAPE_WEIGHT}], got {cost_weight}")
    weights = np.zeros(256, dtype=np.int32)
    costs = np.arange(COST_MAX_FREE + 1)
    weights[: COST_MAX_FREE + 1] = np.rint(SCALE * (1.0 + cost_weight * costs / COST_MAX_FREE))
    weights[COST_INSCRIBED] = round(SCALE * (1.0 + ESCAPE_WEIGHT))
    weights[COST_UNKNOWN] = weights[COST_MAX_FREE] if allow_unknown else 0
    return weights


@njit(cache=True, error_model="numpy", inline="always")
def _octile(d_row, d_col):
    """Return the length of the shortest way over free cells."""
    d_row, d_col = abs(d_row), abs(d_col)
    return SCALE * (STRAIGHT * max(d_row, d_col) + (DIAGONAL - STRAIGHT) * min(d_row, d_col))


@njit(cache=True, error_model="numpy")
def search(costs, weights, start_row, start_col, goal_row, goal_col):
    """Spread from a start until the goal is reached, or everywhere where `goal_row` is negative.

    A robot that stands where its footprint touches something may walk on through such cells until it is out of them,
    and enters none again. Diagonal steps need both cells beside them open. The queue is Dial's (1969): a ring of
    buckets, one per estimated total, last in first out, so that ties go to the way that has come farthest; twice to
    three times as fast here as a binary heap.

    Args:
        costs: shape (height, width), uint8.
        weights: shape (256,), int32, see `step_weights`.
        start_row: row of the start.
        start_col: column of the start.
        goal_row: row of the goal, -1 for none.
        goal_col: column of the goal.

    Returns:
        Travel costs, shape (height + 2, width + 2), int32, and the index into `STEPS` of the step that led to each
        cell, same shape, uint8; both with a border of one cell. Final along the way to the goal.
    """
    height, width = costs.shape
    stride = width + 2
    padded = np.full((height + 2) * stride, COST_LETHAL, dtype=np.uint8)
    for row in range(height):
        padded[(row + 1) * stride + 1 : (row + 1) * stride + 1 + width] = costs[row]
    travel = np.full(padded.size, UNREACHED, dtype=np.int32)
    came_by = np.full(padded.size, NO_STEP, dtype=np.uint8)
    is_final = np.zeros(padded.size, dtype=np.bool_)
    heads = np.full(NUM_BUCKETS, -1, dtype=np.int32)
    nodes = np.empty(padded.size, dtype=np.int32)
    following = np.empty(padded.size, dtype=np.int32)
    has_goal = goal_row >= 0
    goal = (goal_row + 1) * stride + goal_col + 1 if has_goal else -1
    is_open = np.empty(8, dtype=np.bool_)
    jumps = np.array([d_row * stride + d_col for d_row, d_col in STEPS])

    start = (start_row + 1) * stride + start_col + 1
    travel[start] = 0
    total = _octile(goal_row - start_row, goal_col - start_col) if has_goal else 0
    nodes[0], following[0] = start, -1
    heads[total % NUM_BUCKETS] = 0
    num_entries = num_waiting = 1
    while num_waiting > 0:
        while heads[total % NUM_BUCKETS] < 0:
            total += 1
        entry = heads[total % NUM_BUCKETS]
        heads[total % NUM_BUCKETS] = following[entry]
        num_waiting -= 1
        node = np.uint32(nodes[entry])
        if is_final[node]:
            continue
        is_final[node] = True
        here = travel[node]
        if node == goal:
            break
        row, col = node // stride - 1, node % stride - 1
        escaping = padded[node] == COST_INSCRIBED or padded[node] == COST_LETHAL
        for k in range(8):
            neighbour = np.uint32(node + jumps[k])
            cost = padded[neighbour]
            weight = weights[cost]
            is_open[k] = weight > 0 and (cost != COST_INSCRIBED or escaping)
            if k >= 4:
                is_open[k] = is_open[k] and is_open[k - 4] and is_open[(k - 3) & 3]
            there = here + weight * (STRAIGHT if k < 4 else DIAGONAL)
            if not is_open[k] or there >= travel[neighbour]:
                continue
            travel[neighbour] = there
            came_by[neighbour] = k
            if has_goal:
                d_row, d_col = STEPS[k]
                there += _octile(row + d_row - goal_row, col + d_col - goal_col)
            if num_entries == nodes.size:
                nodes = np.concatenate((nodes, np.empty_like(nodes)))
                following = np.concatenate((following, np.empty_like(following)))
            bucket = np.uint32(there % NUM_BUCKETS)
            nodes[num_entries], following[num_entries] = neighbour, heads[bucket]
            heads[bucket] = num_entries
            num_entries += 1
            num_waiting += 1
    return travel.reshape(height + 2, stride), came_by.reshape(height + 2, stride)
