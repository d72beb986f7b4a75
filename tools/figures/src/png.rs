//! Pixel backend and PNG encoder.
//!
//! Every length is doubled, so that a picture stays sharp on a high-density screen. Text is drawn
//! with an installed typeface.

use std::io::{self, Write};

use flate2::{Compression, Crc, write::ZlibEncoder};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
    text_anchor::{HPos, VPos},
};
use plotters_bitmap::{BitMapBackend, BitMapBackendError};

use crate::font::Typeface;

/// Pixels per unit of length.
const SCALE: u32 = 2;
/// Bytes per pixel.
const CHANNELS: usize = 3;

type DrawResult = Result<(), DrawingErrorKind<BitMapBackendError>>;

/// Pixel buffer of a picture.
pub(crate) struct Pixels {
    size: (u32, u32),
    rgb: Vec<u8>,
}

impl Pixels {
    /// Creates a white picture of `size` units; each unit is `SCALE` pixels.
    pub(crate) fn new(size: (u32, u32)) -> Self {
        let size = (size.0 * SCALE, size.1 * SCALE);
        Self { size, rgb: vec![255; size.0 as usize * size.1 as usize * CHANNELS] }
    }

    /// Returns a drawing backend for the buffer.
    pub(crate) fn canvas<'a>(&'a mut self, typeface: &'a Typeface) -> Canvas<'a> {
        Canvas { bitmap: BitMapBackend::with_buffer(&mut self.rgb, self.size), typeface }
    }

    /// Encodes the picture as PNG with unfiltered rows in a single stream; see PNG (ISO/IEC 15948),
    /// clauses 5 and 11.
    pub(crate) fn encode(&self) -> io::Result<Vec<u8>> {
        let (width, height) = self.size;
        let mut header = Vec::with_capacity(13);
        header.extend(width.to_be_bytes());
        header.extend(height.to_be_bytes());
        // 8 bits per channel, RGB, deflate, adaptive filtering, not interlaced.
        header.extend([8, 2, 0, 0, 0]);
        let mut rows = ZlibEncoder::new(Vec::new(), Compression::default());
        for row in self.rgb.chunks(width as usize * CHANNELS) {
            rows.write_all(&[0])?;
            rows.write_all(row)?;
        }
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        for (kind, data) in [(b"IHDR", header), (b"IDAT", rows.finish()?), (b"IEND", Vec::new())] {
            let length = u32::try_from(data.len()).map_err(io::Error::other)?;
            let mut sum = Crc::new();
            sum.update(kind);
            sum.update(&data);
            file.extend(length.to_be_bytes());
            file.extend(kind);
            file.extend(data);
            file.extend(sum.sum().to_be_bytes());
        }
        Ok(file)
    }
}

/// Drawing backend that scales all lengths by `SCALE`.
pub(crate) struct Canvas<'a> {
    bitmap: BitMapBackend<'a>,
    typeface: &'a Typeface,
}

/// A style with its stroke scaled by `SCALE`.
struct ScaledStyle<'a, S>(&'a S);

impl<S: BackendStyle> BackendStyle for ScaledStyle<'_, S> {
    fn color(&self) -> BackendColor {
        self.0.color()
    }

    fn stroke_width(&self) -> u32 {
        self.0.stroke_width() * SCALE
    }
}

fn scaled((x, y): BackendCoord) -> BackendCoord {
    (x * SCALE as i32, y * SCALE as i32)
}

impl DrawingBackend for Canvas<'_> {
    type ErrorType = BitMapBackendError;

    fn get_size(&self) -> (u32, u32) {
        let (width, height) = self.bitmap.get_size();
        (width / SCALE, height / SCALE)
    }

    fn ensure_prepared(&mut self) -> DrawResult {
        self.bitmap.ensure_prepared()
    }

    fn present(&mut self) -> DrawResult {
        self.bitmap.present()
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> DrawResult {
        let (x, y) = scaled(point);
        let corner = (x + SCALE as i32 - 1, y + SCALE as i32 - 1);
        self.bitmap.draw_rect((x, y), corner, &color, true)
    }

    /// Draws a stroke as parallel thin lines, because a stroke drawn as a polygon has holes at
    /// sharp bends.
    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> DrawResult {
        let (from, to, color) = (scaled(from), scaled(to), style.color());
        let width = (style.stroke_width() * SCALE) as i32;
        let is_horizontal = (to.0 - from.0).abs() >= (to.1 - from.1).abs();
        for line in 0..width {
            let offset = line - width / 2;
            let shifted = |(x, y): BackendCoord| if is_horizontal { (x, y + offset) } else { (x + offset, y) };
            self.bitmap.draw_line(shifted(from), shifted(to), &color)?;
            // The bitmap backend omits the last pixel of a horizontal line.
            self.bitmap.draw_pixel(shifted(to), color)?;
        }
        Ok(())
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        upper_left: BackendCoord,
        bottom_right: BackendCoord,
        style: &S,
        fill: bool,
    ) -> DrawResult {
        self.bitmap.draw_rect(scaled(upper_left), scaled(bottom_right), &ScaledStyle(style), fill)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> DrawResult {
        let mut path = path.into_iter();
        let Some(mut previous) = path.next() else { return Ok(()) };
        for point in path {
            self.draw_line(previous, point, style)?;
            previous = point;
        }
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(&mut self, center: BackendCoord, radius: u32, style: &S, fill: bool) -> DrawResult {
        self.bitmap.draw_circle(scaled(center), radius * SCALE, &ScaledStyle(style), fill)
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        vert: I,
        style: &S,
    ) -> DrawResult {
        self.bitmap.fill_polygon(vert.into_iter().map(scaled), &ScaledStyle(style))
    }

    fn draw_text<T: BackendTextStyle>(&mut self, text: &str, style: &T, at: BackendCoord) -> DrawResult {
        let em = style.size() as f32 * SCALE as f32;
        let (width, height) = self.typeface.size(text, em);
        let anchor = style.anchor();
        let left = match anchor.h_pos {
            HPos::Left => 0.0,
            HPos::Center => -0.5 * width,
            HPos::Right => -width,
        };
        let top = match anchor.v_pos {
            VPos::Top => 0.0,
            VPos::Center => -0.5 * height,
            VPos::Bottom => -height,
        };
        let (at, transform, color) = (scaled(at), style.transform(), style.color());
        let (bitmap, mut drawn) = (&mut self.bitmap, Ok(()));
        self.typeface.draw(text, em, |x, y, covered| {
            let (x, y) = transform.transform(x + left as i32, y + top as i32);
            if drawn.is_ok() && covered > 0.0 {
                drawn = bitmap.draw_pixel((at.0 + x, at.1 + y), color.mix(f64::from(covered.min(1.0))));
            }
        });
        drawn
    }

    fn estimate_text_size<T: BackendTextStyle>(
        &self,
        text: &str,
        style: &T,
    ) -> Result<(u32, u32), DrawingErrorKind<Self::ErrorType>> {
        let (width, height) = self.typeface.size(text, style.size() as f32);
        Ok((width.ceil() as u32, height.ceil() as u32))
    }
}
