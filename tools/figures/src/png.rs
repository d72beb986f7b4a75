//! A picture of pixels, and its file.
//!
//! Every length is doubled, so that a picture stays sharp on a screen of many pixels; text is drawn with a typeface of the system.

use std::io::{self, Write};

use flate2::{Compression, Crc, write::ZlibEncoder};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
    text_anchor::{HPos, VPos},
};
use plotters_bitmap::{BitMapBackend, BitMapBackendError};

use crate::font::Typeface;

/// Pixels for each unit of length.
const SCALE: u32 = 2;
/// Bytes of a pixel.
const CHANNELS: usize = 3;

type Drawn = Result<(), DrawingErrorKind<BitMapBackendError>>;

/// The pixels of a picture.
pub(crate) struct Pixels {
    size: (u32, u32),
    rgb: Vec<u8>,
}

impl Pixels {
    /// Of a picture of this size.
    pub(crate) fn new(size: (u32, u32)) -> Self {
        let size = (size.0 * SCALE, size.1 * SCALE);
        Self { size, rgb: vec![255; size.0 as usize * size.1 as usize * CHANNELS] }
    }

    /// To be drawn on.
    pub(crate) fn canvas<'a>(&'a mut self, typeface: &'a Typeface) -> Canvas<'a> {
        Canvas { bitmap: BitMapBackend::with_buffer(&mut self.rgb, self.size), typeface }
    }

    /// The file: one stream of unfiltered rows — PNG (ISO/IEC 15948), 5 and 11.
    pub(crate) fn encoded(&self) -> io::Result<Vec<u8>> {
        let (width, height) = self.size;
        let mut header = Vec::with_capacity(13);
        header.extend(width.to_be_bytes());
        header.extend(height.to_be_bytes());
        // 8 bits, RGB, deflate, adaptive filters, not interlaced.
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

/// Draws into pixels.
pub(crate) struct Canvas<'a> {
    bitmap: BitMapBackend<'a>,
    typeface: &'a Typeface,
}

/// A style with its stroke doubled.
struct Doubled<'a, S>(&'a S);

impl<S: BackendStyle> BackendStyle for Doubled<'_, S> {
    fn color(&self) -> BackendColor {
        self.0.color()
    }

    fn stroke_width(&self) -> u32 {
        self.0.stroke_width() * SCALE
    }
}

fn doubled((x, y): BackendCoord) -> BackendCoord {
    (x * SCALE as i32, y * SCALE as i32)
}

impl DrawingBackend for Canvas<'_> {
    type ErrorType = BitMapBackendError;

    fn get_size(&self) -> (u32, u32) {
        let (width, height) = self.bitmap.get_size();
        (width / SCALE, height / SCALE)
    }

    fn ensure_prepared(&mut self) -> Drawn {
        self.bitmap.ensure_prepared()
    }

    fn present(&mut self) -> Drawn {
        self.bitmap.present()
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> Drawn {
        let (x, y) = doubled(point);
        let corner = (x + SCALE as i32 - 1, y + SCALE as i32 - 1);
        self.bitmap.draw_rect((x, y), corner, &color, true)
    }

    /// As many thin lines side by side as the stroke is wide: a stroke as a polygon has holes where it turns sharply.
    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        let (from, to, color) = (doubled(from), doubled(to), style.color());
        let wide = (style.stroke_width() * SCALE) as i32;
        let level = (to.0 - from.0).abs() >= (to.1 - from.1).abs();
        for line in 0..wide {
            let off = line - wide / 2;
            let aside = |(x, y): BackendCoord| if level { (x, y + off) } else { (x + off, y) };
            self.bitmap.draw_line(aside(from), aside(to), &color)?;
            // Of a level line the last pixel is missing.
            self.bitmap.draw_pixel(aside(to), color)?;
        }
        Ok(())
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        upper_left: BackendCoord,
        bottom_right: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Drawn {
        self.bitmap.draw_rect(doubled(upper_left), doubled(bottom_right), &Doubled(style), fill)
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, path: I, style: &S) -> Drawn {
        let mut path = path.into_iter();
        let Some(mut before) = path.next() else { return Ok(()) };
        for point in path {
            self.draw_line(before, point, style)?;
            before = point;
        }
        Ok(())
    }

    fn draw_circle<S: BackendStyle>(&mut self, center: BackendCoord, radius: u32, style: &S, fill: bool) -> Drawn {
        self.bitmap.draw_circle(doubled(center), radius * SCALE, &Doubled(style), fill)
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(&mut self, vert: I, style: &S) -> Drawn {
        self.bitmap.fill_polygon(vert.into_iter().map(doubled), &Doubled(style))
    }

    fn draw_text<T: BackendTextStyle>(&mut self, text: &str, style: &T, at: BackendCoord) -> Drawn {
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
        let (at, transform, color) = (doubled(at), style.transform(), style.color());
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
