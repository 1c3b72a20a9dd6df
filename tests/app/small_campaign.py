"""A campaign of a few short episodes, and a record of it."""

SHORT = """
title = "Short"
episodes = 2
metrics = ["missed", "force_error_N"]

[set]
task.kind = "hold"
camera = { width = 128, height = 106, fx = 91.0, fy = 91.0, cx = 63.0, cy = 51.0 }
situation = { settle = 0.2, held = 0.1, after = 0.05, judged_from = 0.05, profile = "step" }

[sweep]
plant.friction_left = [0.0, 0.3]

[random]
plant.payload = { low = 0.0, high = 0.2 }
"""


def row(index: int, **values: object) -> dict[str, object]:
    return {"index": index, "episode": index // 2, "plant.friction_left": [0.0, 0.3][index % 2], "error": None, **values}
