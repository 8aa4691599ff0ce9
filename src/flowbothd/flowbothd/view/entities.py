"""Names of what is shown."""

WORLD = "world"
CAMERA = f"{WORLD}/camera/points"
OBJECT = f"{WORLD}/object/points"
REMOVED = {
    "robot": (f"{WORLD}/removed/robot", (80, 130, 220)),
    "outliers": (f"{WORLD}/removed/outliers", (230, 140, 30)),
}
SAMPLES = f"{WORLD}/flow/samples"
CHOSEN = f"{WORLD}/flow/chosen"
GRASP = f"{WORLD}/grasp/point"
PULL = f"{WORLD}/grasp/pull"
ROBOT = f"{WORLD}/robot"
PATH = f"{WORLD}/tool_path"
TABLE = f"{WORLD}/table"
DECISIONS = "policy/decisions"
PHASE = "policy/phase"
OPENING = "plots/opening"
TRIALS = "plots/trials"
VACUUM = "plots/vacuum"
FORCE = "plots/force"
