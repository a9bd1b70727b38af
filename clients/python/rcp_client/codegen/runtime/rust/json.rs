/// Bytes, base64 on the wire.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Base64(pub Vec<u8>);

/// Any value.
#[derive(Clone, Debug, PartialEq)]
pub enum Json {
    Null,
    Bool(bool),
    Int(i64),
    Float(f64),
    Text(String),
    List(Vec<Json>),
    Map(BTreeMap<String, Json>),
}

impl Default for Json {
    fn default() -> Self {
        Json::Null
    }
}

impl Json {
    /// Parse a text.
    pub fn parse(text: &str) -> Result<Json, Error> {
        let mut parser = Parser { text: text.as_bytes(), at: 0, depth: 0 };
        let value = parser.value()?;
        parser.space();
        if parser.at < text.len() {
            return Err(parser.fault());
        }
        Ok(value)
    }

    /// A member of a map; `Null` where there is none.
    pub fn get(&self, name: &str) -> &Json {
        match self {
            Json::Map(map) => map.get(name).unwrap_or(&Json::Null),
            _ => &Json::Null,
        }
    }

    pub fn as_text(&self) -> &str {
        match self {
            Json::Text(text) => text,
            _ => "",
        }
    }
}

impl fmt::Display for Json {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Json::Null => out.write_str("null"),
            Json::Bool(value) => write!(out, "{}", value),
            Json::Int(value) => write!(out, "{}", value),
            Json::Float(value) if value.is_nan() => out.write_str("\"NaN\""),
            Json::Float(value) if value.is_infinite() => out.write_str(if *value > 0.0 { "\"Infinity\"" } else { "\"-Infinity\"" }),
            Json::Float(value) => write!(out, "{:?}", value),
            Json::Text(text) => quote(out, text),
            Json::List(items) => {
                out.write_str("[")?;
                for (at, item) in items.iter().enumerate() {
                    write!(out, "{}{}", if at > 0 { "," } else { "" }, item)?;
                }
                out.write_str("]")
            }
            Json::Map(items) => {
                out.write_str("{")?;
                for (at, (name, item)) in items.iter().enumerate() {
                    out.write_str(if at > 0 { "," } else { "" })?;
                    quote(out, name)?;
                    write!(out, ":{}", item)?;
                }
                out.write_str("}")
            }
        }
    }
}

fn quote(out: &mut fmt::Formatter, text: &str) -> fmt::Result {
    out.write_str("\"")?;
    for letter in text.chars() {
        match letter {
            '"' => out.write_str("\\\"")?,
            '\\' => out.write_str("\\\\")?,
            letter if (letter as u32) < 0x20 => write!(out, "\\u{:04x}", letter as u32)?,
            letter => write!(out, "{}", letter)?,
        }
    }
    out.write_str("\"")
}
