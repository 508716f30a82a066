"""Words that all packages share: samples, report, coefficients, units, errors, and the texts of caveats."""
