"use strict";
// Evaluations: the truth as a line, each estimate a dot with its interval.

for (const figure of document.querySelectorAll("figure[data-curve]")) {
  const curve = data.curves[Number(figure.dataset.curve)];
  plotWhenSeen(figure, {
    title: "1 / time to collision, 1/s", unit: "1/s", xLabel: "time, s", x: curve.t_s, range: curve.range, sync: "evaluation",
    lines: [
      { label: "truth", colour: "--warning", values: curve.true_hz },
      { label: "estimate", colour: "--accent", values: curve.found_hz, low: curve.low_hz, high: curve.high_hz, dots: true },
    ],
  });
}
