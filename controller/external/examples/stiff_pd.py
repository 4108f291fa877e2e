"""The law of stiff_pd.c in Python, with only its standard library.

funnel-hil simulate --set controller.law=external \
    --set 'controller.external.command=[python3, stiff_pd.py]'
"""

import struct
import sys

STIFFNESS, DAMPING, INTEGRAL = (9000, 16000, 2500), (400, 700, 90), (20000, 40000, 6000)
RESET, HEADER, ROWS = 0, 8, 8


def torques(rows: list[tuple[float, ...]], step_s: float, sums: list[float]) -> list[float]:
    """Return torques, N m, from rows of position, velocity and their references."""
    answer: list[float] = []
    for i, (q, v, q_ref, v_ref, *_, limit) in enumerate(zip(*rows, strict=True)):
        error = q - q_ref
        wanted = -STIFFNESS[i] * error - DAMPING[i] * (v - v_ref) - INTEGRAL[i] * sums[i]
        answer.append(max(-limit, min(limit, wanted)))
        if answer[-1] == wanted:
            sums[i] += step_s * error
    return answer


def main() -> None:
    """Answer questions until the run is over."""
    sums = [0.0] * 3
    while header := sys.stdin.buffer.read(8 * HEADER):
        question, _version, joints, _time_s, step_s, *_ = struct.unpack(f"{HEADER}d", header)
        joints = int(joints)
        values = struct.unpack(f"{ROWS * joints}d", sys.stdin.buffer.read(8 * ROWS * joints))
        rows = [values[k * joints : (k + 1) * joints] for k in range(ROWS)]
        if question == RESET:
            sums, answer = [0.0] * joints, [0.0] * joints
        else:
            answer = torques(rows, step_s, sums)
        sys.stdout.buffer.write(struct.pack(f"{1 + joints}d", 0.0, *answer))
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
