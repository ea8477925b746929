//! URIs of buffers and images: `data:` and relative files.

use std::path::{Path, PathBuf};

use base64::{
    Engine,
    alphabet::STANDARD,
    engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig},
};
use percent_encoding::percent_decode_str;

/// Padding is optional: some exporters leave it out.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);

/// Where a URI leads.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// Bytes inside the URI and their media type (empty where the URI names none).
    Inline(Vec<u8>, String),
    /// A file relative to the document.
    File(PathBuf),
}

/// Reads a URI. The error is half a sentence for a finding.
pub(crate) fn resolve(uri: &str) -> Result<Target, String> {
    if let Some(rest) = strip_prefix_ignoring_case(uri, "data:") {
        return inline(rest);
    }
    let shown: String = uri.chars().take(80).collect();
    if uri.split(['/', '?', '#']).next().is_some_and(|head| head.contains(':')) {
        return Err(format!("the URI `{shown}` has a scheme; only relative files and data: are read"));
    }
    let text = percent_decode_str(uri)
        .decode_utf8()
        .map_err(|_| format!("the URI `{shown}` is not UTF-8 after percent-decoding"))?;
    if text.is_empty() {
        return Err("the URI is empty".to_owned());
    }
    if text.contains('\0') {
        return Err(format!("the URI `{shown}` contains a NUL"));
    }
    // A backslash start or a drive letter would be absolute on Windows.
    let drive = text.as_bytes().get(1) == Some(&b':');
    if text.starts_with(['/', '\\']) || drive || Path::new(text.as_ref()).is_absolute() {
        return Err(format!("the URI `{shown}` is an absolute path"));
    }
    Ok(Target::File(PathBuf::from(text.into_owned())))
}

fn strip_prefix_ignoring_case<'a>(text: &'a str, prefix: &str) -> Option<&'a str> {
    let head = text.get(..prefix.len())?;
    head.eq_ignore_ascii_case(prefix).then(|| &text[prefix.len()..])
}

fn inline(rest: &str) -> Result<Target, String> {
    let (head, body) = rest.split_once(',').ok_or("the data URI has no comma")?;
    let mut words = head.split(';');
    let mime = words.next().unwrap_or_default().trim().to_ascii_lowercase();
    let bytes = if words.any(|w| w.trim().eq_ignore_ascii_case("base64")) {
        let body = percent_decode_str(body).collect::<Vec<u8>>();
        BASE64.decode(&body).map_err(|e| format!("the data URI is not base64 ({e})"))?
    } else {
        percent_decode_str(body).collect()
    };
    Ok(Target::Inline(bytes, mime))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_decoded_and_stay_relative() {
        assert_eq!(resolve("a%20b/../c.bin"), Ok(Target::File(PathBuf::from("a b/../c.bin"))));
        for bad in ["/etc/hosts", "%2Fetc/hosts", "http://x/y", "file:///x", "C:\\x", "\\\\x\\y", "a%00b", ""]
        {
            assert!(resolve(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn data_uris_with_and_without_padding() {
        let want = Target::Inline(b"hi".to_vec(), "image/png".to_owned());
        assert_eq!(resolve("data:image/png;base64,aGk="), Ok(want));
        assert_eq!(resolve("DATA:;base64,aGk"), Ok(Target::Inline(b"hi".to_vec(), String::new())));
        assert_eq!(
            resolve("data:text/plain,a%41"),
            Ok(Target::Inline(b"aA".to_vec(), "text/plain".to_owned()))
        );
        assert!(resolve("data:text/plain;base64").is_err());
        assert!(resolve("data:;base64,a$k=").is_err());
    }
}
