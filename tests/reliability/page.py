"""The tables in results.md: rows of a campaign that has run replace its own, the others stay."""

BEGIN, END = "<!-- begin: {} -->", "<!-- end: {} -->"
TABLES = {
    "results": ("campaign", "promise", "tried", "measured"),
    "runs": ("campaign", "date", "version", "processor", "minutes", "CPU minutes"),
}


def replace_rows(path, name, results, run):
    """Put a campaign's results into the page, and its date, version, processor, minutes and CPU minutes."""
    from .test_campaigns import CAMPAIGNS

    text = path.read_text(encoding="utf-8")
    new = {"results": [_result(name, result) for result in results], "runs": [_row((name, *run))]}
    for table, headings in TABLES.items():
        before, inside, after = parts(text, table)
        kept = [line for line in inside.splitlines() if line.startswith("| ")][1:]
        rows = {each: [line for line in kept if line.startswith(f"| {each} |")] for each in CAMPAIGNS}
        rows[name] = new[table]
        lines = [_row(headings), "|---" * len(headings) + "|", *(line for each in rows.values() for line in each)]
        text = "\n".join([before, "", *lines, "", after])
    path.write_text(_with_total(text, CAMPAIGNS), encoding="utf-8")


def parts(text, table):
    """Return the page up to the rows of a table, these, and what follows."""
    begin, end = BEGIN.format(table), END.format(table)
    before, found, rest = text.partition(begin)
    inside, found_end, after = rest.partition(end)
    if not (found and found_end):
        raise ValueError(f"the page has no {begin} ... {end}")
    return before + begin, inside, end + after


def _with_total(text, names):
    """State below the table of the runs how much CPU time all of them took."""
    before, _, after = parts(text, "total")
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in parts(text, "runs")[1].splitlines()]
    minutes = {row[0]: float(row[-1]) for row in cells if row and row[0] in names}
    missing = [name for name in names if name not in minutes]
    but = f", without {', '.join(missing)}" if missing else ""
    line = (
        f"All campaigns together took {sum(minutes.values()):.1f} minutes of CPU time{but}; the longest one "
        f"{max(minutes.values(), default=0.0):.1f}."
    )
    return "\n".join([before, "", line, "", after])


def _result(name, result):
    broken = f"; **{len(result['faults'])} faults**" if result["faults"] else ""
    test = f" (`{result['test']}`)" if result["test"] else ""
    return _row((name, result["promise"] + test, result["tried"], result["measured"] + broken))


def _row(cells):
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"
