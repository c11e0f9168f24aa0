"""What words mean: all that names of columns, paths, labels and heads of files are read by.

A name says what its whole words say. Each list is a pattern of one word; where a word of a list
would say nothing to everyone, it is asked.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

TIME = "time|timestamp|stamp|t|clock|elapsed|when|date|datetime|zeit|temps|tiempo|tempo"
TIME_UNITS = {
    "s": "s|secs?\\.?|seconds?",
    "ms": "ms|msecs?|millis|milliseconds?",
    "us": "[uµμ]s|usecs?|micros|microseconds?",
    "ns": "ns|nsecs?|nanos?|nanosecs?|nanoseconds?",
}
_OTHER_TIMES = "mins?|minutes?|h|hrs?|hours?|days?|cs|centiseconds?|frames|ticks"
OTHER_TIMES = f"{_OTHER_TIMES}|frame|tick"
"""Units of time that are none of ours; one frame may have its time."""
NO_CLOCK = re.compile(
    rf"[\[(](?!(?i:{'|'.join(TIME_UNITS.values())}|\d+|h+:m+:s+\W*\w*|utc|gmt|local|unix|epoch)[\])])"
    r"|(?:(?<![A-Za-z\d])|(?<=[a-z])(?=[A-Z]))"
    rf"(?i:{_OTHER_TIMES}|\d+[muµμn]s|angle|deg|degrees|rad|left|remain|remains|remaining|"
    r"countdown|video|camera|hold)(?![a-z])"
)
"""In the name of a time: another unit, in brackets or as a word, or another quantity."""
SIGNAL_UNITS = {
    "N": "N|(?i:newtons?)",
    "mN": "(?i:mn|millinewtons?)",
    "cN": "(?i:cn|centinewtons?)",
    "dN": "dN|(?i:decinewtons?)",
    "kN": "(?i:kn|kilonewtons?)",
    "gf": "g|(?i:gf|gforce|grams?(force)?)",
    "kgf": "(?i:kgf?|kgforce|kp|kilograms?(force)?)",
    "lbf": "(?i:lbf?|lbs|lbforce|pounds?(force)?)",
    "ozf": "(?i:ozf?|ozforce|ounces?(force)?)",
    "uT": "(?i:[uµμ]t|microteslas?)",
    "mT": "(?i:mt|milliteslas?)",
    "G": "G|(?i:gs|gauss)",
    "T": "T|(?i:teslas?)",
    "count": "(?i:counts?|raw|adc|lsb|digits)",
}
"""Unit -> its words; G is gauss and g is gram."""
UNIT_OF_FORCE = "[mcdk]N|gf|(?i:kgf|lbf|ozf|(?:milli|centi|deci|kilo)?newtons?)"
"""Words that are a unit of force and nothing else."""
UNIT_WORD = re.compile(
    rf"(?<![^\W_])(?:{UNIT_OF_FORCE}|(?i:[mck]n|[muµμ]t|gf|kg|kp|lbs?|oz|gauss|pounds?|ounces?|"
    r"(?:milli|micro)?teslas?|(?:kilo)?grams?))(?![^\W_]|[^(\[]*[)\]])"
)
"""A word of a name that is a unit wherever it stands."""
UNIT_OF_PATH = re.compile(rf"(?<![^\W_])(?!(?i:newton))(?:{UNIT_OF_FORCE})(?![^\W_])")
"""A word of a path that is the unit of its readings; kg and lb are of an object, Newton a name."""
NO_UNIT = (
    r"(?i:\d+|(?:(?:f|force|sensor|finger|tip|pad|taxel|values?|filt(?:ered)?|cal(?:ibrated)?|"
    r"axis|mag|data)[\W\d_]*?)+)"
)
"""Words behind an axis, or in brackets, that are no unit."""
NO_SENSOR = (
    "torque|moment|translation|rotation|quaternion|orientation|covariance|gyro|pose|position|pos|"
    "angular|velocity|vel|acc|accel|acceleration|imu|joint|marker|transform|action|state|"
    "displacement|disp|deformation|cop|angle|direction|dir|resultant|total|sum|net|euler|"
    "drehmoment|weg|winkel|summe|mittelwert|mean|average|avg|median|max|min|range|peak|std|rms|"
    "var|variance|skew|skewness|kurtosis"
)
"""Words of three axes that are no reading of a fingertip, or only what was taken from many."""
OF_A_NAME = r"(?:id|name|nr|no|num|number|code|index|\d+)"
"""Words behind what a column names."""
UNIT_COLUMN = re.compile(
    rf"(?i)(?!.*(?<![a-z])({TIME}|{NO_SENSOR}|mass|weight|length|size|temp|id)(?![a-z]))"
    r".*(?<![a-z])units?(?![a-z]).*"
)
"""A column of the unit of the readings, and of no other quantity."""
_A_TRIAL = "trial|run|recording|episode"
NAMED = {
    "person": "person|subject|participant|user",
    "object": "object|item|obj",
    "action": "action|condition|task|outcome|result|success|successful|dropped|failed",
    "column": f"{_A_TRIAL}|rep|repetition|sheet",
}
"""What a column holds: what a trial is called by, or its number -> words of its name."""
OF_A_TRIAL = f"{_A_TRIAL}|rep|repetition|test|cycle|session|subject|versuch|messung"
"""Words with a number that tells trials apart."""
_OF_PEOPLE = f"{NAMED['person']}|p|s|vp|sub|subj|proband"
_OF_TRIALS = (
    f"{_A_TRIAL}|rep|take|t|r|rec|log|test|nr|no|file|data|ses|session|day|set|exp|scan"
)
NUMBERS = "one|two|three|four|five|six|seven|eight|nine|ten"
PERSON = re.compile(rf"(?i)({_OF_PEOPLE})[-_ ]?\d+")
NUMBERED = re.compile(
    rf"(?i:(?:{_OF_TRIALS})?(?:[-_ ]?\d+)+|(?:{_OF_TRIALS})[-_ ]?(?:{NUMBERS}))"
)
"""Words of paths that number people and trials."""
TOGETHER = (
    rf"(?i:(?:{_OF_PEOPLE}|{_OF_TRIALS})[-_ ]?\d+|(?:{_OF_TRIALS})[-_ ](?:{NUMBERS})"
    r"|(?:no|non|not|with|without|pre|post|anti|near)[-_ ](?:slip|drop|fall)\w*?"
    r"|hand[-_ ]over|put[-_ ]down)"
)
"""What is one word of a path although a sign of a gap stands in it."""
LABEL = (
    "labels?|events?|phase|state|situation|markers?|annotation|class|slip|slipping|status|trigger|"
    "what|was|type"
)
TRIAL = f"{_A_TRIAL}|file|log|name"
BEGIN = "start|begin|from|von|onset|t0|at|first"
START = f"{BEGIN}|{TIME}"
ROWS = "rows?|index|samples?"
LENGTH = "duration|length"
END = f"end|stop|to|bis|until|offset|finish|t1|last|{LENGTH}"
"""Words of the columns of labels, and of a table of events."""
HELD = "(?:no|non|not|without) ?(?:slip|drop|fall)|stable|still|steady|held"
OUTCOMES = {
    "grasp": HELD,
    "safe_slip": "safe slip|safe|release|pass|hand ?over|put down|place",
    "risky_slip": (
        "risky|gross slip|with slip|slip|slid|slide|sliding|drop|fall|fallen|fell|tug|pull|torn"
    ),
}
"""Situation -> its words, which also name a whole trial."""
SITUATIONS = {
    **OUTCOMES,
    "": "unlabel|unknown|none|ignore",
    "nothing": "nothing|no contact|open|empty|idle|rest|free|no touch",
    "grasp": f"{HELD}|grasp|hold|grip|contact|lift|carry|touch",
}
"""Situation -> words in labels that mean it."""
FILLERS = f"{START}|is|has|the|a|object|hand|phase|state|labels?|event|class|flag|gt|truth|data"
"""Words beside them that change nothing."""
ENDINGS = "(?:s|es|d|[a-z]?ed|[a-z]?ing)?"
"""Of a word in another form: slips, slipped, slipping."""
OVER = "end|stop|finish|off|offset"
"""Before or behind the word of what ends there."""
OFF = "|0|no|false|off|n|f|\\.|-|none|nein|non"
"""What stands where a mark is not."""
FINGERS = (
    "thumb|th|daumen|pouce|pulgar|pollice|one",
    "index|fore|pointer|ff|zeigefinger|indice|two",
    "middle|mf|mittelfinger|majeur|three", "ring|rf|annulaire|anulare?|four",
    "little|pinky|lf|kleine[rn]?[-_ ]?finger|auriculaire|menique|mignolo|five",
    "six", "seven", "eight", "nine", "ten", "palm",
)  # fmt: skip
"""Words of fingers, and of their numbers, in the order of a hand."""


def words_of(name: str) -> set[str]:
    """Lower-case words, also the parts of `thumbX`, thumb and x, and those with a number, as t0."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    words = re.findall(r"[^\W\d_]+|[^\W_]+", f"{name} {parted}")
    return {word.lower() for word in (*words, *re.split(r"[\W_]", name))}


def says(name: str, words: str) -> bool:
    """Whether a name has one of some words."""
    return any(re.fullmatch(words, word) for word in words_of(name))


def is_called(name: str, words: str) -> bool:
    """Whether a name is one of some words, such as `object`, `Object ID` or `meta.object_name`."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name.rpartition(".")[2]).lower()
    plain = re.sub(r"[\W_]+", " ", parted).strip()
    return re.fullmatch(rf"({words})( ?{OF_A_NAME})*", plain) is not None


def meaning(word: str, meanings: Mapping[str, str]) -> str | None:
    """What a word means, of things and their words; None where it means none of them."""
    found = (thing for thing, words in meanings.items() if re.fullmatch(words, word))
    return next(found, None)


def unit_of_time(name: str) -> str | None:
    """The unit that a name of time has."""
    units = (unit for unit, words in TIME_UNITS.items() if says(name, words))
    return next(units, None)
