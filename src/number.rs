//! Numbers in reports and messages: short, whatever their size.

use std::fmt;

/// Numbers from here on have an exponent in a table or a sentence.
const LARGE: f64 = 1e6;

/// A number for a table: three decimals, an exponent if it is large, a dash for NaN.
#[cfg(any(feature = "cli", test))]
pub(crate) fn fixed(value: f64) -> String {
    const DECIMALS: usize = 3;
    /// Shown where a number does not apply.
    const NONE: &str = "-";
    match () {
        () if value.is_nan() => NONE.to_owned(),
        () if value.is_infinite() => value.to_string(),
        () if value.abs() < LARGE => format!("{:.DECIMALS$}", value + 0.0),
        () => format!("{value:.DECIMALS$e}"),
    }
}

/// A number for a sentence: the decimals of the format string, an exponent if it is large.
pub(crate) struct Short(pub(crate) f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.is_finite() && self.0.abs() >= LARGE { fmt::LowerExp::fmt(&self.0, f) } else { self.0.fmt(f) }
    }
}

/// A number for a message: the shortest digits that read back as the same number, an exponent if it is very large or small.
pub(crate) fn exact(value: f64) -> String {
    let size = value.abs();
    if size == 0.0 || !size.is_finite() || (1e-5..1e9).contains(&size) {
        value.to_string()
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_numbers_have_an_exponent() {
        let cases = [(1.23456, "1.235"), (-2.0, "-2.000"), (-0.0, "0.000"), (1e300, "1.000e300"), (1e-9, "0.000")];
        for (value, text) in cases {
            assert_eq!(fixed(value), text);
        }
        assert_eq!([f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(fixed), ["-", "inf", "-inf"]);
    }

    #[test]
    fn numbers_in_sentences_are_short() {
        for (value, text) in [(1.23456, "1.23"), (-0.5, "-0.50"), (999_999.0, "999999.00"), (-1.234e300, "-1.23e300")] {
            assert_eq!(format!("{:.2}", Short(value)), text);
        }
        assert_eq!(format!("{:.2} {:.2}", Short(f64::NAN), Short(f64::INFINITY)), "NaN inf");
    }

    #[test]
    fn exact_numbers_are_short_and_read_back() {
        for (value, text) in [(0.0, "0"), (0.05, "0.05"), (-1.0, "-1"), (1e300, "1e300"), (2.5e-7, "2.5e-7")] {
            assert_eq!(exact(value), text);
            assert_eq!(text.parse::<f64>().unwrap(), value);
        }
        assert_eq!(exact(f64::NAN), "NaN");
    }
}
