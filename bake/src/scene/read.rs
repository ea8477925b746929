//! Small readers of JSON values, for glTF properties and for our own words alike.

use glam::{DVec3, Vec3};
use serde_json::{Map, Value};

use super::findings::Findings;
use crate::error::Finding;

/// A non-negative integer; `3.0` counts as one, as JSON makes no difference.
pub(crate) fn index_of(value: &Value) -> Option<usize> {
    if let Some(n) = value.as_u64() {
        return usize::try_from(n).ok();
    }
    let f = value.as_f64()?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked")]
    (f.fract() == 0.0 && (0.0..=9.0e15).contains(&f)).then_some(f as usize)
}

/// A number that is finite as `f32`.
pub(crate) fn float(value: &Value) -> Option<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "rounding is meant; overflow is checked")]
    value.as_f64().map(|f| f as f32).filter(|f| f.is_finite())
}

/// An array of `N` numbers.
pub(crate) fn doubles<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let list = value.as_array().filter(|l| l.len() == N)?;
    let mut out = [0.0; N];
    for (o, v) in out.iter_mut().zip(list) {
        *o = v.as_f64().filter(|f| f.is_finite())?;
    }
    Some(out)
}

/// An array of `N` numbers that are finite as `f32`.
pub(crate) fn floats<const N: usize>(value: &Value) -> Option<[f32; N]> {
    let list = value.as_array().filter(|l| l.len() == N)?;
    let mut out = [0.0; N];
    for (o, v) in out.iter_mut().zip(list) {
        *o = float(v)?;
    }
    Some(out)
}

/// A value as findings show it: its JSON, cut to a readable length.
pub(crate) fn shown(value: &Value) -> String {
    let text = value.to_string();
    let mut out: String = text.chars().take(48).collect();
    if out.len() < text.len() {
        out.push('…');
    }
    out
}

/// A number, or a text that holds one: custom properties are often typed in as text.
pub(crate) fn scalar(value: &Value) -> Option<f32> {
    match value {
        Value::String(s) => s.trim().parse::<f32>().ok().filter(|f| f.is_finite()),
        _ => float(value),
    }
}

/// A colour or strength: one number for all channels, three numbers, or the same as text, or
/// `#rrggbb` (sRGB).
pub(crate) fn triple(value: &Value) -> Option<Vec3> {
    match value {
        Value::String(s) => triple_from_text(s),
        Value::Array(_) => floats::<3>(value).map(Vec3::from),
        _ => float(value).map(Vec3::splat),
    }
}

/// Text form of [`triple`].
pub(crate) fn triple_from_text(text: &str) -> Option<Vec3> {
    let text = text.trim();
    if let Some(hex) = text.strip_prefix('#') {
        if hex.len() != 6 || !hex.bytes().all(|b| b.is_ascii_hexdigit()) {
            return None;
        }
        let rgb = u32::from_str_radix(hex, 16).ok()?;
        let channel = |shift: u32| srgb_to_linear(((rgb >> shift) & 255) as f32 / 255.0);
        return Some(Vec3::new(channel(16), channel(8), channel(0)));
    }
    let inner = text.trim_start_matches(['[', '(']).trim_end_matches([']', ')']);
    let parts: Vec<f32> = inner
        .split([',', ' ', ';'])
        .filter(|s| !s.is_empty())
        .map(|s| s.parse::<f32>().ok().filter(|f| f.is_finite()))
        .collect::<Option<_>>()?;
    match parts[..] {
        [v] => Some(Vec3::splat(v)),
        [r, g, b] => Some(Vec3::new(r, g, b)),
        _ => None,
    }
}

/// Inverse of the sRGB transfer function; input and output in [0, 1].
pub(crate) fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// The sRGB transfer function; input and output in [0, 1].
pub(crate) fn linear_to_srgb(v: f32) -> f32 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Rounds to single precision; what overflows becomes infinite.
#[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
pub(crate) fn single(v: DVec3) -> Vec3 {
    Vec3::new(v.x as f32, v.y as f32, v.z as f32)
}

/// A table of our own words: knows which keys were asked for and reports the others.
pub(crate) struct Table<'a> {
    map: &'a Map<String, Value>,
    path: String,
    known: Vec<&'static str>,
}

const FIX_TYPE: &str = "correct the value";

impl<'a> Table<'a> {
    /// Wraps an object; anything else is an error.
    pub(crate) fn new(value: &'a Value, path: impl Into<String>, out: &mut Findings) -> Option<Self> {
        let path = path.into();
        match value.as_object() {
            Some(map) => Some(Self { map, path, known: Vec::new() }),
            None => {
                out.push(Finding::error(path, format!("{} is not a table of words", shown(value)), FIX_TYPE));
                None
            }
        }
    }

    /// The value of a key, unless absent or null.
    pub(crate) fn get(&mut self, key: &'static str) -> Option<&'a Value> {
        self.known.push(key);
        self.map.get(key).filter(|v| !v.is_null())
    }

    /// Where a key is.
    pub(crate) fn at(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// Reads a key with `read`; says what was `expected` where that fails.
    pub(crate) fn read<T>(
        &mut self,
        key: &'static str,
        expected: &str,
        out: &mut Findings,
        read: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Option<T> {
        let value = self.get(key)?;
        let got = read(value);
        if got.is_none() {
            let what = format!("`{}` is not {expected}", shown(value));
            out.push(Finding::error(self.at(key), what, format!("write {expected}")));
        }
        got
    }

    /// A number in a range.
    pub(crate) fn number(
        &mut self,
        key: &'static str,
        expected: &str,
        out: &mut Findings,
        ok: impl Fn(f32) -> bool,
    ) -> Option<f32> {
        self.read(key, expected, out, |v| scalar(v).filter(|f| ok(*f)))
    }

    /// A yes or no; 0, 1, `on` and `off` are taken too.
    pub(crate) fn flag(&mut self, key: &'static str, out: &mut Findings) -> Option<bool> {
        self.read(key, "true or false", out, |v| match v {
            Value::Bool(b) => Some(*b),
            Value::String(s) => match s.trim().to_ascii_lowercase().as_str() {
                "true" | "on" | "yes" | "1" => Some(true),
                "false" | "off" | "no" | "0" => Some(false),
                _ => None,
            },
            _ => match float(v) {
                Some(0.0) => Some(false),
                Some(1.0) => Some(true),
                _ => None,
            },
        })
    }

    /// A word out of a list; case does not matter. Gives the list's spelling.
    pub(crate) fn word(
        &mut self,
        key: &'static str,
        list: &[&'static str],
        out: &mut Findings,
    ) -> Option<&'static str> {
        let expected = format!("one of {}", list.join(", "));
        self.read(key, &expected, out, |v| {
            let text = v.as_str()?.trim();
            list.iter().copied().find(|w| w.eq_ignore_ascii_case(text))
        })
    }

    /// Any text.
    pub(crate) fn text(&mut self, key: &'static str, out: &mut Findings) -> Option<String> {
        self.read(key, "text", out, |v| v.as_str().map(str::to_owned))
    }

    /// A colour or strength that is not negative.
    pub(crate) fn colour(&mut self, key: &'static str, out: &mut Findings) -> Option<Vec3> {
        let expected = "a number or three numbers, none negative";
        self.read(key, expected, out, |v| triple(v).filter(|c| 0.0 <= c.min_element()))
    }

    /// A point or vector.
    pub(crate) fn vector(&mut self, key: &'static str, out: &mut Findings) -> Option<Vec3> {
        self.read(key, "three numbers", out, |v| match v {
            Value::Array(_) | Value::String(_) => triple(v),
            _ => None,
        })
    }

    /// Keys that start with `prefix`, in file order; they count as known.
    pub(crate) fn starting_with(&self, prefix: &str) -> Vec<&'a str> {
        self.map.keys().map(String::as_str).filter(|k| k.starts_with(prefix)).collect()
    }

    /// The value of a key that was found by [`Table::starting_with`].
    pub(crate) fn value(&self, key: &str) -> Value {
        self.map.get(key).cloned().unwrap_or_default()
    }

    /// Reports keys that nobody asked for. In extras (`foreign`), where other tools keep their own
    /// words, only what looks like a slip of the pen is a warning.
    pub(crate) fn finish(self, foreign: bool, prefix: &str, out: &mut Findings) {
        for key in self.map.keys() {
            if self.known.contains(&key.as_str()) || (!prefix.is_empty() && key.starts_with(prefix)) {
                continue;
            }
            let (nearest, similarity) = nearest(key, &self.known);
            let slip = 0.8 <= similarity;
            let name: String = key.chars().take(48).collect();
            let what = format!("unknown word `{name}`");
            let fix = match nearest {
                Some(word) if slip || !foreign => format!("the nearest known word is `{word}`"),
                _ => "nothing, if another tool uses it".to_owned(),
            };
            let path = self.at(&name);
            out.push(if slip || !foreign {
                Finding::warning(path, what, fix)
            } else {
                Finding::info(path, what, fix)
            });
        }
    }
}

/// The most similar of `words` and how similar it is, 0 to 1.
pub(crate) fn nearest<'w>(text: &str, words: &[&'w str]) -> (Option<&'w str>, f64) {
    // Comparing is quadratic, so absurdly long words are cut.
    let text: String = text.chars().take(64).collect::<String>().to_ascii_lowercase();
    words.iter().fold((None, 0.0), |best, word| {
        let s = strsim::jaro_winkler(&text, word);
        if best.1 < s { (Some(*word), s) } else { best }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn triples_in_all_spellings() {
        let half = Some(Vec3::splat(0.5));
        for v in
            [json!(0.5), json!("0.5"), json!("0.5,0.5,0.5"), json!([0.5, 0.5, 0.5]), json!("(0.5, 0.5, 0.5)")]
        {
            assert_eq!(triple(&v), half, "{v}");
        }
        assert_eq!(triple(&json!("#ff0000")), Some(Vec3::X));
        for v in [
            json!("red"),
            json!([1, 2]),
            json!("1e40"),
            json!("#ff"),
            json!(true),
            json!("nan"),
            json!("#-12345"),
        ] {
            assert_eq!(triple(&v), None, "{v}");
        }
    }

    #[test]
    fn a_slip_is_named() {
        let mut out = Findings::default();
        let value = json!({"casts_shadows": true, "cycles_visibility": 3});
        let mut t = Table::new(&value, "nodes[0].extras", &mut out).expect("a table");
        assert_eq!(t.flag("casts_shadow", &mut out), None);
        t.finish(true, "", &mut out);
        let list = out.finish();
        assert_eq!(list.len(), 2);
        assert!(list[0].fix.contains("casts_shadow"));
        assert_eq!(list[0].severity, crate::error::Severity::Warning);
        assert_eq!(list[1].severity, crate::error::Severity::Info);
    }
}
