"""stub"""

BATCH_ENTRY = ""


def function_text(fd):
    return ""


def robot_text(character, law, terrain, layout):
    return ""
