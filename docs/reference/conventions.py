"""Writes conventions.json: attitudes in every convention, computed from the definitions with matrices only.

Each attitude is given by yaw, pitch and roll. Its matrix is the product of three elementary rotations. All other values are
computed from this matrix, or from the matrices of other frames. Usage: `python3 docs/reference/conventions.py > docs/reference/conventions.json`
"""

import json
from math import asin, atan2, cos, hypot, pi, radians, sin, sqrt

GRAVITY_M_S2 = 9.80665
NAMES = {
    "level, facing north": (0, 0, 0),
    "level, facing east": (-90, 0, 0),
    "level, facing west": (90, 0, 0),
    "level, facing south": (180, 0, 0),
    "nose up": (0, 30, 0),
    "right side down": (0, 0, 30),
    "climbing left turn": (40, 20, -50),
    "nose down, past the side": (-120, -35, 100),
    "on the right side": (10, 0, 90),
    "inverted by roll": (30, 0, 180),
    "inverted by pitch": (180, 0, 180),
    "nearly inverted": (-77, 1, 179),
    "nose straight up": (25, 90, 0),
    "nose straight down": (-70, -90, 40),
}


def about_x(angle):
    """Returns the matrix that gives the components of a fixed vector after the axes were rotated by `angle` about x."""
    return [[1, 0, 0], [0, cos(angle), sin(angle)], [0, -sin(angle), cos(angle)]]


def about_y(angle):
    return [[cos(angle), 0, -sin(angle)], [0, 1, 0], [sin(angle), 0, cos(angle)]]


def about_z(angle):
    return [[cos(angle), sin(angle), 0], [-sin(angle), cos(angle), 0], [0, 0, 1]]


def product(*matrices):
    result, *rest = matrices
    for matrix in rest:
        result = [[sum(row[k] * matrix[k][j] for k in range(3)) for j in range(3)] for row in result]
    return result


def transposed(matrix):
    return [list(column) for column in zip(*matrix)]


def quaternion(rotation):
    """Returns w, x, y, z of a rotation matrix, by Shepperd's method. The first component that is not zero is positive."""
    m = rotation
    squares = [
        1 + m[0][0] + m[1][1] + m[2][2],
        1 + m[0][0] - m[1][1] - m[2][2],
        1 - m[0][0] + m[1][1] - m[2][2],
        1 - m[0][0] - m[1][1] + m[2][2],
    ]
    products = [
        [0, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]],
        [m[2][1] - m[1][2], 0, m[0][1] + m[1][0], m[0][2] + m[2][0]],
        [m[0][2] - m[2][0], m[0][1] + m[1][0], 0, m[1][2] + m[2][1]],
        [m[1][0] - m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1], 0],
    ]
    largest = squares.index(max(squares))
    size = sqrt(squares[largest])
    q = [size / 2 if i == largest else products[largest][i] / (2 * size) for i in range(4)]
    sign = next(x for x in q if abs(x) > 1e-12)
    return [x if sign > 0 else -x for x in q]


def shortest(n):
    """Returns the matrix reference → body of the shortest rotation from up to n, by Rodrigues' formula about n × up."""
    a, b, c = n
    sine = hypot(a, b)
    x, y = (b / sine, -a / sine) if sine > 0 else (1, 0)
    cross = [[0, 0, y], [0, 0, -x], [-y, x, 0]]
    square = product(cross, cross)
    identity = [[float(i == j) for j in range(3)] for i in range(3)]
    return [[identity[i][j] - sine * cross[i][j] + (1 - c) * square[i][j] for j in range(3)] for i in range(3)]


# Matrices from the native axes to those of another frame. The rows are the axes of that frame.
SAME = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
FLU = NWU = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
FRD = NED = [[0, 1, 0], [1, 0, 0], [0, 0, -1]]
FRAMES = {"enu-flu": (SAME, FLU), "nwu-flu": (NWU, FLU), "ned-frd": (NED, FRD)}
RATE = [0.1, -0.2, 0.3]


def point(matrix):
    """Returns u, v and z of a matrix reference → body."""
    n = [row[2] for row in matrix]
    turn = product(transposed(shortest(n)), matrix)
    return n[0] / (1 + n[2]), n[1] / (1 + n[2]), atan2(turn[0][1], turn[0][0])


def in_frame(to_reference, inverted, earth, body):
    """Returns the attitude from the axes `body` to the axes `earth`. Yaw, pitch and roll are successive rotations about the third,
    second and first body axis."""
    rotation = product(earth, to_reference, transposed(body))
    over = product(body, [[1, 0, 0], [0, -1, 0], [0, 0, -1]], transposed(body))
    u, v, z = point(product(over, transposed(rotation)) if inverted else transposed(rotation))
    return {
        "quaternion_wxyz": quaternion(rotation),
        "yaw_rad": atan2(rotation[1][0], rotation[0][0]),
        "pitch_rad": asin(max(-1.0, min(1.0, -rotation[2][0]))),
        "roll_rad": atan2(rotation[2][1], rotation[2][2]),
        "u": u,
        "v": v,
        "z_rad": z,
        "rate_rad_s": [sum(part * rate for part, rate in zip(row, RATE)) for row in body],
    }


def attitude(name, yaw_deg, pitch_deg, roll_deg):
    yaw, pitch, roll = radians(yaw_deg), radians(pitch_deg), radians(roll_deg)
    # Reference → body, with the axes right, forward, up. Pitch is about x, roll about y.
    matrix = product(about_y(roll), about_x(pitch), about_z(yaw))
    inverted = matrix[2][2] < -1e-12
    # The inverted chart is the upright chart of the body rotated by π about its right axis.
    seen = product([[1, 0, 0], [0, -1, 0], [0, 0, -1]], matrix) if inverted else matrix
    u, v, z = point(seen)
    to_reference = transposed(matrix)
    return {
        "name": name,
        "yaw_rad": yaw,
        "pitch_rad": pitch,
        "roll_rad": roll,
        "course_rad": (-yaw) % (2 * pi),
        "near_gimbal": abs(pitch_deg) > 89,
        "chart": "inverted" if inverted else "upright",
        "u": u,
        "v": v,
        "z_rad": z,
        "inclination_rad": atan2(hypot(matrix[0][2], matrix[1][2]), matrix[2][2]),
        "matrix_reference_to_body": matrix,
        "quaternion_wxyz": quaternion(to_reference),
        "rate_rad_s": RATE,
        "frames": {name: in_frame(to_reference, inverted, *axes) for name, axes in FRAMES.items()},
        "force_at_rest_m_s2": [GRAVITY_M_S2 * row[2] for row in matrix],
    }


print(json.dumps([attitude(name, *angles) for name, angles in NAMES.items()], indent=1, ensure_ascii=False))
