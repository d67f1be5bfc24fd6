"""Contacts at any scale, from the table to the verdict: a result that is right, or a reason that is true.

The contacts are those of `tests.fitting.scales`, whose simulator shares nothing with rig_sim.  Each is written as a
table, imported, and fitted as a person would.  To see contact 17 again:

    python -m tests.fitting.scales 17 17.csv        writes its table and prints the two commands

At full size a line of JSON per contact goes to build/reliability/contacts.jsonl, as the contacts end.
"""

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stickslip.errors import EXIT_DATA, EXIT_DONE, EXIT_NO_LAW, EXIT_UNDECIDED

from ..fitting import scales
from .forked import Ended, Server
from .result import Result, Size

ROOT = Path(__file__).resolve().parents[2]
LOG = ROOT / "build/reliability/contacts.jsonl"
LONGEST_S = 120.0  # of CPU time
HANGS_S = 600.0  # of wall time; the computer may be busy
SHORT_ROWS = 1_500  # of a table at the short size, so that its contacts take less than a minute together
WARM = 32  # law 3, 1535 rows: what the server compiles and imports for all

RESULTS = (EXIT_DONE, EXIT_UNDECIDED, EXIT_NO_LAW)
# Below these a record is refused.  Within a sample of the bound either is right: slips begin and end between samples.
FEWEST_SAMPLES, FEWEST_STICKS, SAMPLES_APART = 8.0, 4, 1.0
SAMPLES = re.compile(r"(\d+(?:\.\d+)?) samples (?:a|per) slip")
RATE = re.compile(r"(\d+(?:\.\d+)?) ?(k?)Hz")
NAMED_WITHIN = 0.3  # of the samples a slip: what a record shows of them against what they are
RATE_ENOUGH = 0.8  # of the rate at which a slip has the fewest samples: what is advised against what would do
# What may be said of a record that holds fewer than the fewest sticks.
FEW_STICKS = re.compile(
    r"(without a|this run has no) sustained stick|no slip between two sticks|complete stick-slip cycle|never slips"
)
# From here on the law must be found, in this share of the contacts.
ENOUGH_SAMPLES, ENOUGH_CYCLES, PROMISED = 20.0, 10.0, 0.95
FEWEST_COUNTED = 20  # contacts of which a share of 0.95 says anything; fewer, and one failure would break the promise
LISTED = 40  # contacts that a row of the table names


@dataclass(frozen=True)
class Outcome:
    """What became of one contact.

    ``exit``, ``what``, ``cpu_s`` are those of the command that ended last, ``what`` its error; ``broken`` says what no
    command may do; ``named`` is the set of laws, ``adequacy`` and ``p_value`` the goodness of fit.
    """

    number: int
    kind: str
    truth: scales.Truth
    rate_hz: float
    exit: int
    what: str
    broken: str
    cpu_s: float
    verdict: str
    named: tuple[int, ...]
    adequacy: str
    p_value: float | None

    @property
    def law(self) -> int | None:
        return scales.LAWS.get(self.kind)

    @property
    def right(self) -> bool:
        return self.law in self.named and self.adequacy == "adequate"

    @property
    def counted(self) -> bool:
        return self.truth.samples_per_slip >= ENOUGH_SAMPLES and self.truth.cycles >= ENOUGH_CYCLES

    def __str__(self) -> str:
        """One line with what to run to see it again."""
        held = f"{self.truth.samples_per_slip:.1f} samples a slip, {self.truth.sticks} sticks"
        ended = self.what or f"set {list(self.named)}, {self.adequacy}, p {self.p_value}"
        again = f"python -m tests.fitting.scales {self.number} {self.number}.csv"
        return f"contact {self.number}, {self.kind}, {held}: exit {self.exit}, {ended}: {again}"


def contacts(size: Size, folder: Path, server: Server) -> list[Result]:
    log = LOG if size.full else folder / LOG.name
    log.parent.mkdir(parents=True, exist_ok=True)
    found = []
    with log.open("w", encoding="utf-8") as lines:
        scales.write_table(scales.draw(WARM), folder / "warm.csv")
        for line in scales.commands(scales.draw(WARM), "warm.csv", "warm.h5"):
            server.warm(line, folder)
        for number in _numbers(size):
            found.append(_tried(server, number, folder))
            lines.write(json.dumps(asdict(found[-1])) + "\n")
            lines.flush()
    return [_ends(found), _reasons(found), _laws(found), _foreign(found), _judged(found)]


def _numbers(size: Size) -> Iterator[int]:
    """Yield the numbers of the contacts: one kind after the other, at the short size the first with a short table."""
    if size.full:
        yield from range(size.amount)
        return
    kinds = len(scales.KINDS)
    for place in range(size.amount):
        number = place
        while _rows(number) > SHORT_ROWS or number // kinds < place // kinds:
            number += kinds
        yield number


def _rows(number: int) -> float:
    drawn = scales.draw(number)
    return drawn.contact.duration * drawn.rate_hz


def _tried(server: Server, number: int, folder: Path) -> Outcome:
    """Follow one contact, and run its two commands."""
    drawn = scales.draw(number)
    truth = scales.write_table(drawn, folder / "t.csv")
    broken: list[str] = []
    for line in scales.commands(drawn, "t.csv", "t.h5"):
        done = server.run(line, folder, hangs_s=HANGS_S, all_laws=True)
        broken += _broken(done)
        if done.code != EXIT_DONE:
            break
    try:
        document: dict[str, Any] = json.loads(done.out)
    except ValueError:
        document = {}
    for left in folder.glob("t.*"):
        left.unlink()
    error, adequacy = document.get("error"), document.get("adequacy") or {}
    return Outcome(
        number=number,
        kind=drawn.kind,
        truth=truth,
        rate_hz=drawn.rate_hz,
        exit=done.code,
        what=f"{error['what']}; {error['do']}" if error else "" if document else done.err.strip()[-300:],
        broken=", ".join(broken),
        cpu_s=done.cpu_s,
        verdict=document.get("verdict") or "",
        named=tuple(document.get("set") or ()),
        adequacy=adequacy.get("verdict") or "",
        p_value=adequacy.get("p_value"),
    )


def _broken(done: Ended) -> list[str]:
    found = []
    if done.hung or done.cpu_s > LONGEST_S:
        found.append(f"{done.cpu_s:.0f} s of CPU time")
    if done.traceback or done.code not in (*RESULTS, EXIT_DATA):
        found.append(f"exit {done.code}")
    found += dict.fromkeys(re.findall(r"RuntimeWarning: .*", done.err))
    return found


def _ends(found: list[Outcome]) -> Result:
    broken = [each for each in found if each.broken]
    ends = Counter(each.exit for each in found)
    slowest = max(each.cpu_s for each in found)
    total = sum(each.cpu_s for each in found)
    return Result(
        f"a contact of any scale ends with a result, or with a reason: no traceback, no RuntimeWarning, at most "
        f"{LONGEST_S:.0f} s of CPU time",
        f"{_tried_all(found)}, by an encoder or a camera, calibrated or not, mirrored, with any origin of x and t",
        f"{', '.join(f'exit {code}: {ends[code]}' for code in sorted(ends))}; {len(found) - len(broken)} as promised; "
        f"the slowest took {slowest:.0f} s, the mean {total / len(found):.1f} s",
        tuple(f"{each.broken}: {each}" for each in broken),
    )


def _tried_all(found: list[Outcome]) -> str:
    return (
        f"{len(found)} contacts of the six laws and four others, {scales.MASS[0]} to {scales.MASS[1]:.0f} kg, "
        f"{scales.OMEGA[0]:.0f} to {scales.OMEGA[1]:.0f} rad/s, Fs/k {1e3 * scales.STRETCH[0]:.1f} to "
        f"{1e3 * scales.STRETCH[1]:.0f} mm, about {scales.SAMPLES[0]:.0f} to {scales.SAMPLES[1]:.0f} samples a slip, "
        f"{scales.CYCLES[0]:.0f} to {scales.CYCLES[1]:.0f} cycles"
    )


def _reasons(found: list[Outcome]) -> Result:
    refused = [each for each in found if each.exit == EXIT_DATA]
    untrue = {each.number: why for each in found if not each.broken and (why := untrue_reason(each))}
    few = [each for each in found if each.truth.samples_per_slip < FEWEST_SAMPLES]
    return Result(
        f"a record is refused (exit 4) for a reason that is true; below {FEWEST_SAMPLES:.0f} samples a slip it is "
        "refused with the samples a slip and a rate that would do",
        f"the same contacts, {len(few)} with fewer than {FEWEST_SAMPLES:.0f} samples a slip",
        f"{len(refused)} refused; {len(untrue)} not as promised",
        tuple(f"{untrue[each.number]}: {each}" for each in found if each.number in untrue),
    )


def untrue_reason(found: Outcome) -> str:
    """Return what is wrong with how a record was refused, or not refused; "" where nothing is."""
    samples, sticks = found.truth.samples_per_slip, found.truth.sticks
    slips = sticks >= FEWEST_STICKS  # the samples of a slip are those of slips between sticks
    if found.exit != EXIT_DATA:
        accepted = slips and samples < FEWEST_SAMPLES - SAMPLES_APART
        return "not refused" if accepted and found.exit in RESULTS else ""
    if sticks < FEWEST_STICKS and FEW_STICKS.search(found.what):
        return ""
    if samples >= FEWEST_SAMPLES + SAMPLES_APART:
        return "refused for a reason that is not true"
    named, rate = SAMPLES.search(found.what), RATE.search(found.what)
    if named is None or rate is None:
        return "does not name the samples a slip and a rate"
    if abs(float(named[1]) - samples) > max(NAMED_WITHIN * samples, SAMPLES_APART):
        return "names other samples a slip"
    advised = float(rate[1]) * (1e3 if rate[2] else 1.0)
    return "names too low a rate" if advised < RATE_ENOUGH * FEWEST_SAMPLES * found.rate_hz / samples else ""


def _laws(found: list[Outcome]) -> Result:
    counted = [each for each in found if each.law and each.counted]
    wrong = [each for each in counted if not each.right]
    share = 1 - len(wrong) / len(counted) if counted else 1.0
    kept = share >= PROMISED or len(counted) < FEWEST_COUNTED
    return Result(
        f"the contact's law is in the set and describes the record, in {100 * PROMISED:.0f} % of the contacts with "
        f"{ENOUGH_SAMPLES:.0f} samples a slip and {ENOUGH_CYCLES:.0f} cycles or more",
        f"{len(counted)} contacts of one of the six laws",
        f"{100 * share:.1f} %; not found: {_by_kind(wrong, counted)}{_listed(wrong)}",
        () if kept else tuple(str(each) for each in wrong),
    )


def _foreign(found: list[Outcome]) -> Result:
    """State how often another curve, or another spring, is given one of the six laws: a figure, not yet a promise."""
    foreign = [each for each in found if each.law is None]
    named = [each for each in foreign if each.exit == EXIT_DONE and len(each.named) == 1]
    enough = [each for each in foreign if each.counted]
    among = [each for each in named if each.counted]
    return Result(
        "how often a contact that is none of the six is named one of them alone (a figure without a bound)",
        f"{len(foreign)} contacts with a Stribeck or logarithmic curve or a spring that hardens",
        f"{_percent(named, foreign)}; with {ENOUGH_SAMPLES:.0f} samples a slip and {ENOUGH_CYCLES:.0f} cycles or more "
        f"{_percent(among, enough)}; {_by_kind(named, foreign)}{_listed(named)}",
    )


def _judged(found: list[Outcome]) -> Result:
    adequate = [each for each in found if each.adequacy == "adequate"]
    unjudged = [each for each in adequate if each.p_value is None]
    return Result(
        "a law is called adequate only where its goodness of fit was judged",
        f"the same contacts, {len(adequate)} with an adequate law",
        f"{len(adequate) - len(unjudged)} judged, {len(unjudged)} not",
        tuple(str(each) for each in unjudged),
    )


def _percent(part: list[Outcome], whole: list[Outcome]) -> str:
    return f"{len(part)} of {len(whole)} ({100 * len(part) / max(len(whole), 1):.1f} %)"


def _by_kind(part: Iterable[Outcome], whole: Iterable[Outcome]) -> str:
    some, every = Counter(each.kind for each in part), Counter(each.kind for each in whole)
    return ", ".join(f"{kind} {some[kind]}/{every[kind]}" for kind in scales.KINDS if every[kind])


def _listed(some: list[Outcome]) -> str:
    """Name contacts by their numbers; the log holds those beyond `LISTED`."""
    if not some:
        return ""
    more = f" and {len(some) - LISTED} more" if len(some) > LISTED else ""
    return f"; contacts {', '.join(str(each.number) for each in some[:LISTED])}{more}"
