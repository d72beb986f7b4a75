//! Dashed lines.
//!
//! Dashes are measured along the horizontal axis instead of along the line, so that a noisy curve
//! has as many dashes as a smooth one.

/// Returns the drawn pieces of a dashed line. From x = `from` on, dashes of `on` units and gaps of
/// `off` units alternate.
pub(crate) fn dashes(line: &[(f64, f64)], from: f64, on: f64, off: f64) -> Vec<Vec<(f64, f64)>> {
    let period = on + off;
    let period_bounds = |x: f64| {
        // The end of a period belongs to the next period, even if rounding makes it slightly too
        // small.
        let start = from + ((x - from) / period + 1e-9).floor() * period;
        (start + on, start + period)
    };
    let mut pieces: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut piece: Vec<(f64, f64)> = Vec::new();
    for pair in line.windows(2) {
        let ((mut x, mut y), (x_end, y_end)) = (pair[0], pair[1]);
        loop {
            let (dash_end, period_end) = period_bounds(x);
            let is_drawn = x < dash_end;
            match is_drawn {
                true if piece.is_empty() => piece.push((x, y)),
                false if !piece.is_empty() => pieces.push(std::mem::take(&mut piece)),
                _ => {}
            }
            let next = if is_drawn { dash_end } else { period_end };
            // A vertical or backward segment is not divided. A segment is also not divided further
            // if rounding makes the next step zero.
            if next >= x_end || next <= x {
                if is_drawn {
                    piece.push((x_end, y_end));
                }
                break;
            }
            y += (y_end - y) * (next - x) / (x_end - x);
            x = next;
            if is_drawn {
                piece.push((x, y));
            }
        }
    }
    pieces.push(piece);
    pieces.retain(|piece| piece.len() > 1);
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_alternate_with_gaps() {
        let line = [(0.0, 0.0), (5.0, 5.0), (10.0, 0.0)];
        let expected =
            [vec![(0.0, 0.0), (3.0, 3.0)], vec![(4.0, 4.0), (5.0, 5.0), (7.0, 3.0)], vec![(8.0, 2.0), (10.0, 0.0)]];
        assert_eq!(dashes(&line, 0.0, 3.0, 1.0), expected);
    }

    #[test]
    fn dash_count_ignores_noise_and_rounding() {
        let noise: Vec<_> = (0..10_000).map(|k| (f64::from(k) * 0.1, f64::from(k % 7))).collect();
        assert_eq!(dashes(&noise, 0.0, 7.0, 3.0).len(), 100);
        let steep = [(1e9, 0.0), (1e9, 5.0), (1e9 + 1e-7, 0.0)];
        assert!(dashes(&steep, 0.0, 1e-9, 1e-9).len() < 1000);
        let long = dashes(&[(0.1, 0.0), (100.1, 0.0)], 0.1, 0.7, 0.3);
        let drawn: f64 = long.iter().map(|piece| piece[1].0 - piece[0].0).sum();
        assert!(long.len() == 100 && (drawn - 70.0).abs() < 1e-6, "{} dashes, {drawn}", long.len());
    }
}
