"""One finding for one cause: what many topics get wrong in the same way is said once."""

from __future__ import annotations

from raw2drive_ros.conformance.observation import Verdict

# So many topics with one fault are reported together.
TOGETHER = 3


def summarised(verdicts: list[Verdict]) -> list[Verdict]:
    """The verdicts in their order; errors and warnings of at least `TOGETHER` subjects (`SUBJECT: CHECK`) with one
    remedy become one, at the place of the first."""
    groups: dict[tuple[str, str, str], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.severity in ('error', 'warning') and ': ' in verdict.check:
            groups.setdefault(_key(verdict), []).append(verdict)
    found: list[Verdict] = []
    for verdict in verdicts:
        group = groups.get(_key(verdict), [])
        if len(group) < TOGETHER:
            found.append(verdict)
        elif group[0] is verdict:
            subjects = [each.check.rsplit(': ', 1)[0] for each in group]
            check = f'{verdict.check.rsplit(": ", 1)[1]}, {len(group)} times'
            found.append(Verdict(check, verdict.severity, f'{verdict.text} ({", ".join(subjects)})', verdict.remedy))
    return found


def _key(verdict: Verdict) -> tuple[str, str, str]:
    return verdict.check.rsplit(': ', 1)[-1], verdict.severity, verdict.remedy
