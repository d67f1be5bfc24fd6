"""Reports of the best law in the form of lmfit, whose users know where to look."""

from fitting.result import Ranking

LEAST_CORRELATION = 0.1  # listed, as in lmfit


def fit_report(ranking: Ranking) -> str:
    best = ranking.best
    lines = ["[[Model]]", f"    {best.called}, F = {best.fit.law.written}", "[[Fit Statistics]]"]
    numbers = {
        "data points": best.fit.residual.size,
        "cycles": best.cycles,
        "rms residual": f"{best.rms_m:.4g} m",
        "misfit": f"{best.misfit:.4g} (rms over noise)",
        "Akaike info crit": f"{best.aic:.8g}",
        "Bayesian info crit": f"{best.bic:.8g}",
    }
    lines += [f"    {name:18} = {number}" for name, number in numbers.items()]
    lines.append("[[Variables]]")
    width = max(map(len, best.parameters)) + 1
    lines += [f"    {f'{name}:':{width}} {item.brief}" for name, item in best.parameters.items()]
    correlations = ranking.correlations()
    if correlations is not None:
        lines.append(f"[[Correlations]] (unreported correlations are < {LEAST_CORRELATION:.3f})")
        names, matrix = correlations.names, correlations.matrix
        pairs = [(i, j) for j in range(len(names)) for i in range(j) if abs(matrix[i, j]) >= LEAST_CORRELATION]
        for i, j in sorted(pairs, key=lambda pair: -abs(matrix[pair])):
            lines.append(f"    C({names[i]}, {names[j]}) = {matrix[i, j]:+.4f}")
    return "\n".join(lines)


def ci_report(ranking: Ranking) -> str:
    confidence = f"{100 * (1 - ranking.alpha):g}%"
    rows = [("", confidence, "best", confidence)]
    for name, item in ranking.best.parameters.items():
        digits = item.decimals
        ends = (f"{item.lo:.{digits}f}", f"{item.value:.{digits}f}", f"{item.hi:.{digits}f}")
        withheld = ("withheld", f"{item.value:.4g}", "withheld")
        rows.append((f"{name}:", *(ends if item.trusted else withheld)))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    return "\n".join(
        "  ".join([f"{row[0]:{widths[0]}}", *(f"{row[k]:>{widths[k]}}" for k in (1, 2, 3))]) for row in rows
    )
