"""Places of the plots on the page; `report.js` draws them."""

from __future__ import annotations

__all__ = ["plots"]


def plots() -> str:
    """Places of the plots, with what they show in words; a script fills them."""

    def plot(name: str, label: str, kind: str = "") -> str:
        return f'<div id="{name}" class="plot {kind}" role="img" aria-label="{label}"></div>'

    def part(name: str, title: str, line: str, label: str) -> str:
        return (
            f'<section id="{name}-part"><h3>{title}</h3><p class="quiet small">{line}</p>{plot(name, label)}</section>'
        )

    return (
        '<noscript><p class="notice">The tables need no script; the plots do.</p></noscript>'
        '<div id="plots"><h2>The ladder</h2><div class="controls"><label for="metric">Metric</label>'
        '<select id="metric"></select></div><p class="quiet small"><span id="ladder-line"></span> From the measurement '
        "at the top to the bound; dots with 95 % intervals, the dotted line is the oracle.</p>"
        + plot("ladder", "Ladder of estimators with intervals; the numbers are in the leaderboard")
        + "<h2>Around switches and surges</h2><p class=\"quiet small\">Root mean square over events of all runs. "
        "Click a name in a legend to show or hide it; colour, dash and marker go together.</p>"
        + part("switch", "After a switch of intent", "Error around the moment at which the target changes its mind.",
               "Error against time around switches of intent")
        + part("surge", "After a surge begins", "Error around the moment at which the noise grows.",
               "Error against time around the beginning of noise surges")
        + part("whole", "Over the whole run", "Root mean square over runs.", "Error against time over the run")
        + '<h2>Consistency</h2><p class="quiet small">The shaded band holds 95 % of the means of a consistent '
        "estimator: above it, an estimator is too sure of itself.</p>"
        + part("nees", "NEES", "Squared error of position and velocity over its covariance.", "NEES against time")
        + part("nis", "NIS", "Squared innovation over its covariance, for each component.", "NIS against time")
        + "<h2>What it believes</h2>"
        + part("intents", "Probability of the true intent", "Around switches.", "Probability of the true intent")
        + part("surges", "Probability of a surge", "Around the beginning of surges.", "Probability of a surge")
        + '<section id="cost-part"><h2>Cost and accuracy</h2><p class="quiet small">Down and to the left is better. '
        "Both axes are logarithmic.</p>" + plot("cost", "Position error against time for a step") + "</section>"
        + '<section id="play-part"><h2>Playback</h2><p class="quiet small">The first run. Ellipses hold 95 %. Shaded: '
        "the noise surges; dotted: switches of intent.</p>"
        '<div class="controls"><label for="who">Estimator</label><select id="who"></select>'
        '<label for="other">and</label><select id="other"></select></div>'
        '<div class="controls"><button type="button" id="play">Play</button>'
        '<label class="skip" for="time">Time</label><input id="time" type="range" min="0" max="1" value="0"></div>'
        '<p id="now" class="small"></p><div class="pair">'
        + plot("map", "Map of the run with truth, measurements and estimates", "map")
        + plot("strips", "Error, noise and intent against time", "map")
        + "</div></section></div>"
    )  # fmt: skip
