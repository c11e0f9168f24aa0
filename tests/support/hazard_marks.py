"""The hazards by name: what can go wrong, what the software does, and what is left to the hand's
own controller.

@FOREIGN_CHIP.mark
def test_a_scan_leaves_an_eeprom_as_it_was(): ...

docs/safety.md is written from these and from how the marked tests went (`make safety`).
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Hazard:
    """A row of docs/safety.md: one sentence each. left: what the software cannot do."""

    area: str
    hazard: str
    does: str
    left: str

    @property
    def mark(self) -> pytest.MarkDecorator:
        """For a test that shows it."""
        return pytest.mark.hazard(
            self.area, self.hazard, does=self.does, left=self.left
        )


RECORDINGS, BUS, LIVE = "Recordings", "Sensors and bus", "The live loop"
DECISIONS, OUTSIDE = "Decisions", "Input from outside"
STUDIES = "Studies with people"

DAMAGED_FILE = Hazard(
    RECORDINGS,
    "A recording has a damaged header or a torn last line",
    "`check --repair` moves at most one torn last line beside the file; it refuses where header "
    "and rows disagree",
    "A person mends a damaged header",
)
READABLE_BY_OTHERS = Hazard(
    RECORDINGS,
    "Other users of the computer can read a participant's files",
    "New files respect the umask",
    "The permissions of the folder above",
)
OVERWRITTEN = Hazard(
    RECORDINGS,
    "A command overwrites an earlier result",
    "It refuses without `--force`, and never replaces its own input or another output",
    "Backups",
)
HALF_FINISHED = Hazard(
    RECORDINGS,
    "A command is stopped half-way",
    "Unfinished output has another name until it is whole, or says that it is unfinished",
    "Running the command again",
)
SOURCE_ENDED = Hazard(
    RECORDINGS,
    "The source ends in the middle of a trial",
    "The recorder says so and does not keep the trial",
    "Recording the trial again",
)
ADVERSE_EVENT = Hazard(
    STUDIES,
    "A participant is harmed or feels unwell",
    "One key ends a trial at once; time and step are on the disk before anything is asked, and the "
    "report begins with it",
    "Looking after the person, and the hand's own switch: the study does not control the hand",
)
WITHDRAWAL = Hazard(
    STUDIES,
    "A participant withdraws, and some of the recordings stay",
    "Every file of that person is deleted and named; one that cannot be deleted is an error, and a "
    "deletion that did not end is reported at the next start",
    "Copies, backups, the list of names on paper, and models trained with the recordings",
)
CUT_OFF_STUDY = Hazard(
    STUDIES,
    "The program or the terminal dies in the middle of a study",
    "The same command goes on in the step it was in; at most the line or the sample being "
    "written is lost",
    "Running the command again",
)
FOREIGN_CHIP = Hazard(
    BUS,
    "A foreign chip is on the bus",
    "`scan` only reads from an address that has not identified itself as a known sensor",
    "Keeping other chips off the bus in use",
)
CORRUPT_READING = Hazard(
    BUS,
    "The bus flips bits",
    "A reading whose status cannot be the chip's, or that is all zeros or ones, is invalid; a "
    "flipped bit of a value is not seen, and is wrong for one sample",
    "A bus short and clean enough to be read, and an address of its own for each sensor",
)
SLOW_REPAIR = Hazard(
    BUS,
    "A sensor comes back on a bus that is read slowly",
    "It is valid again from its second new reading on; the repair does not trigger itself again",
    "Nothing",
)
STUCK_BUS = Hazard(
    BUS,
    "SDA or SCL is held low when the hand starts",
    "Nine clocks free SDA; a held SCL is reported once; every later reading is "
    "invalid until the bus is free",
    "Power cycling a sensor that holds SCL",
)
BRIDGE_FAULT = Hazard(
    BUS,
    "The USB bridge halts an endpoint, or a start fails half-way",
    "The halt is cleared; a failed start releases the interface",
    "Power on USB",
)
WIRING = Hazard(
    BUS,
    "The wiring or the address of a mux is wrong",
    "The message names the likely wire or address",
    "A person mends the wiring",
)
DEAD_LOG = Hazard(
    LIVE,
    "A terminal, a pipe, a log or a disk takes nothing any more",
    "Control goes on; the failed sink is dropped, counted and reported on the others",
    "The last command holds if every consumer that can act is gone",
)
RESTART = Hazard(
    LIVE,
    "The program restarts while the hand holds something, or with a bias that is stale",
    "Forces above the stored unloaded bias are reported as `started_loaded`, once in words with "
    "the bias and its date, and `nothing` is not answered until the hand has been empty",
    "The hand's own controller keeps its grip while no answer comes",
)
DEAD_HAND = Hazard(
    LIVE,
    "The hand repeats old readings",
    "Repeats are counted per sensor over its valid readings; a hand of repeating "
    "sensors is `unknown`",
    "The hand holds its grip on `unknown`",
)
FROZEN_SENSOR = Hazard(
    LIVE,
    "One sensor freezes at a reading that looks good, while others live",
    "The driver goes by the chip's own counter; without one, a sensor whose noise was seen counts "
    "as lost once it has repeated for 0.2 s while another one changed",
    "The hand holds its grip on `unknown`; a sensor that repeats at rest is not judged",
)
STALE_LINES = Hazard(
    LIVE,
    "A program that sends samples as lines is stuck, late or silent",
    "Late and silent are judged on arrival: what did not come in time is lost, what waited while "
    "nothing was read is dropped, and the state is `unknown`",
    "A delay that is constant from the start cannot be seen without a common clock",
)
LATE_ANSWER = Hazard(
    LIVE,
    "An answer is late because the computer paused",
    "An answer older than two periods says `late` and its state is `unknown`",
    "A watchdog that holds the grip while no answer comes",
)
WRONG_RATE = Hazard(
    LIVE,
    "The source runs at another rate, or its clock stands still",
    "The monitor notices by itself and answers `unknown`",
    "Nothing",
)
LOST_SENSOR = Hazard(
    LIVE,
    "A sensor is lost, stale, saturated or not finite",
    "The state is `unknown`; where the model declares that the others are enough, it is `degraded` "
    "and never a safe slip",
    "The hand holds its grip on `unknown`",
)
SILENT_CUES = Hazard(
    LIVE,
    "The wearer takes the silence of the vibration motor for a safe grip",
    "The unknown state has a cue of its own, which repeats and ends every run; lines go on "
    "while no cue is due, and say after which time a device must take the link for lost",
    "A device that vibrates where no line comes, and a motor that can be felt",
)
OVERRIDE = Hazard(
    DECISIONS,
    "The wearer overrides, and the alarm comes back at once",
    "Override ends every request and lasts until the hand has been empty, or for two "
    "seconds after its last command",
    "Following the wearer's command before any request",
)
OPENING = Hazard(
    DECISIONS,
    "The wearer opens the hand while it tightens",
    "Opening ends a running act and prevents a new one",
    "Opening the hand",
)
HOLDS_AGAINST_WEARER = Hazard(
    DECISIONS,
    "The hand holds against its wearer",
    "A target is what the hand may add while its wearer does not open it: the example receivers "
    "ignore it from that very sample on, whatever lines come or stay away; an opening that "
    "reaches the run ends the answer there too",
    "The decision that the wearer opens, a filter of muscle artefacts, and ignoring the target "
    "then: the link is one-way, so a run cannot test it",
)
NO_EVIDENCE = Hazard(
    DECISIONS,
    "A false alarm keeps the hand tight",
    "An act without fresh evidence ends after a time that the model's card states, "
    "and the answer says so",
    "Giving the grip back slowly, where the run sends no grip commands",
)
SILENT_SENDER = Hazard(
    DECISIONS,
    "The sender of the wearer's commands goes silent",
    "Its last command expires after 0.3 s, and every answer says so",
    "Nothing",
)
INVARIANTS = Hazard(
    DECISIONS,
    "A sequence of inputs that no test thought of",
    "All reachable states and inputs of the decision are searched, and the invariants hold in each",
    "Nothing",
)
TROUBLE_EVERY_SECOND = Hazard(
    LIVE,
    "Faults, signals, pauses, full disks and forged datagrams come one after another for an hour",
    "Every sample is answered or counted, every command arrives, unknown states let nothing go, "
    "and memory does not grow (`make soak` plays the hour; this is a part of it)",
    "Hardware that fails in other ways than the emulated one",
)
SUPERVISOR_INVARIANTS = Hazard(
    DECISIONS,
    "A grip controller wants too much, for too long, or against the wearer",
    "A supervisor bounds every target; all its reachable states and inputs are searched, and the "
    "invariants hold in each",
    "The force limit of the drive, whatever the request is",
)
IMPOSSIBLE_SENSE = Hazard(
    DECISIONS,
    "The grip controller is fed numbers that cannot be: NaN, infinite, negative, or huge",
    "Each is brought into its range, and a sample with a NaN counts as unknown; targets are "
    "finite and within the ceiling, in C as in Python",
    "The force limit of the drive, whatever the request is",
)
AMBIGUOUS = Hazard(
    OUTSIDE,
    "A file or a stamp means two things, or holds a number that no clock, rate or size can be",
    "It is refused by a typed error: a number that is not finite, a rate outside 0.001 to "
    "100,000 Hz, a stamp beyond 146 years",
    "Numbers that are possible but wrong",
)
TERMINAL_ESCAPES = Hazard(
    OUTSIDE,
    "A file or column name carries terminal escapes",
    "Messages show them as visible characters",
    "Nothing",
)
MISTAKEN_ARGUMENT = Hazard(
    OUTSIDE,
    "A path or a URL means something else",
    "The error says what was meant and what to write",
    "Nothing",
)
RUN_DIES = Hazard(
    LIVE,
    "The run dies while the hand grips an object",
    "The last grip command of a run is `hold`; where it was killed, a receiver holds 300 ms after "
    "its last line",
    "Keeping the grip on `hold`, and following the wearer's commands",
)
NO_GRIP_COMMAND = Hazard(
    LIVE,
    "No grip command reaches the hand, not even the last one",
    "Every command says that it expires after 300 ms; the virtual hand then holds its grip",
    "The hand's own controller holds where no command comes for 300 ms",
)
OLD_COMMAND = Hazard(
    LIVE,
    "An old grip command moves the hand: its receiver was stopped, or the wire is too slow",
    "Every command has its time: the example receivers skip what is older than 300 ms, over a "
    "serial port what comes later than the fastest line by 200 ms, and drop what waited while they "
    "did not look",
    "The same in a receiver of one's own; over a wire, a delay that every line has from the first "
    "on, or that stands for minutes, is not seen",
)
WIRE_FAILS = Hazard(
    LIVE,
    "The wire to the hand fails, or its reader stalls",
    "The loop never waits for it; the failure is reported, the wire is opened again, and its first "
    "command is `hold`",
    "The hand's own controller holds where no command comes for 300 ms",
)
STALE_PAGE = Hazard(
    LIVE,
    "A live page shows an old answer as if it were new",
    "Where the loop sends nothing or the connection is lost, the page says so in place of a state",
    "Following the hand's own controller, and not a page",
)
PAGE_DELAYS = Hazard(
    LIVE,
    "A browser or its network delays the loop",
    "A process of its own serves the page, behind a socket that never blocks",
    "Nothing",
)
FOREIGN_BROWSER = Hazard(
    OUTSIDE,
    "Another site or another machine reaches the live page",
    "Only requests with the token of the run are answered",
    "Choosing a network that is trusted: the page is not encrypted",
)
BROKEN_LINE = Hazard(
    OUTSIDE,
    "A line on a link is cut off, broken, or not a line at all",
    "Commands, the wearer's words and the example receivers skip what is not one JSON object that "
    "they understand; what is skipped is counted and reported once a second",
    "A receiver of one's own must do the same",
)
OTHER_SENDER = Hazard(
    OUTSIDE,
    "A second program, or an old line that comes late, moves the hand",
    "Lines come over a Unix socket or a serial port, and never over a network; a socket file is "
    "for one user; a receiver obeys rising sequences only, within the ceiling and the speed of its "
    "hand",
    "Which programs of this user may run on the board",
)
CROWDED_PAGE = Hazard(
    OUTSIDE,
    "A program shuts the live page with requests that never end",
    "A thread answers each request, and a connection that sends or takes nothing for 5 s ends",
    "A program on the same machine, or with the token, that opens connections without end: the "
    "page stops, the run goes on",
)
DEAF_TERMINAL = Hazard(
    STUDIES,
    "A key does something that the operator did not mean, or does nothing: after Ctrl-Z, an arrow "
    "key, pasted text, a key before the question",
    "Keys work again after `fg`; a key of several bytes is read whole; pasted text is no key; what "
    "was typed before a question is dropped, but for stop and the adverse event",
    "In a terminal without bracketed paste a text that is pasted in a trial is keys",
)
