/// What can be sent and received.
pub trait Value: Sized {
    fn to_json(&self) -> Json;
    fn from_json(json: &Json) -> Result<Self, Error>;
}

fn expected<T>(what: &str, found: &Json) -> Result<T, Error> {
    Err(Error::local("bad_response", format!("expected {}, found {}", what, found)))
}

impl Value for Json {
    fn to_json(&self) -> Json {
        self.clone()
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        Ok(json.clone())
    }
}

impl Value for bool {
    fn to_json(&self) -> Json {
        Json::Bool(*self)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Bool(value) => Ok(*value),
            other => expected("true or false", other),
        }
    }
}

impl Value for i64 {
    fn to_json(&self) -> Json {
        Json::Int(*self)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Int(value) => Ok(*value),
            Json::Text(digits) => digits.parse().or_else(|_| expected("an integer", json)),
            other => expected("an integer", other),
        }
    }
}

impl Value for u64 {
    fn to_json(&self) -> Json {
        i64::try_from(*self).map_or_else(|_| Json::Text(self.to_string()), Json::Int)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Int(value) => u64::try_from(*value).or_else(|_| expected("an integer from 0", json)),
            Json::Text(digits) => digits.parse().or_else(|_| expected("an integer from 0", json)),
            other => expected("an integer from 0", other),
        }
    }
}

impl Value for f64 {
    fn to_json(&self) -> Json {
        Json::Float(*self)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Float(value) => Ok(*value),
            Json::Int(value) => Ok(*value as f64),
            Json::Text(text) if text == "NaN" => Ok(f64::NAN),
            Json::Text(text) if text == "Infinity" => Ok(f64::INFINITY),
            Json::Text(text) if text == "-Infinity" => Ok(f64::NEG_INFINITY),
            other => expected("a number", other),
        }
    }
}

impl Value for String {
    fn to_json(&self) -> Json {
        Json::Text(self.clone())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Text(text) => Ok(text.clone()),
            other => expected("a text", other),
        }
    }
}

impl Value for () {
    fn to_json(&self) -> Json {
        Json::Null
    }
    fn from_json(_: &Json) -> Result<Self, Error> {
        Ok(())
    }
}

const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

impl Value for Base64 {
    fn to_json(&self) -> Json {
        let mut text = String::new();
        for group in self.0.chunks(3) {
            let bits = group.iter().fold(0u32, |all, byte| all << 8 | *byte as u32) << (8 * (3 - group.len()));
            for at in 0..4 {
                let digit = DIGITS[(bits >> (18 - 6 * at) & 63) as usize] as char;
                text.push(if at > group.len() { '=' } else { digit });
            }
        }
        Json::Text(text)
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        let (mut made, mut bits, mut held) = (Vec::new(), 0u32, 0);
        for letter in json.as_text().bytes().filter(|letter| *letter != b'=') {
            let digit = DIGITS.iter().position(|known| *known == letter);
            bits = bits << 6 | digit.ok_or_else(|| Error::local("bad_response", "no base64".into()))? as u32;
            held += 6;
            if held >= 8 {
                held -= 8;
                made.push((bits >> held) as u8);
            }
        }
        Ok(Base64(made))
    }
}

impl<T: Value> Value for Option<T> {
    fn to_json(&self) -> Json {
        self.as_ref().map_or(Json::Null, |value| value.to_json())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Null => Ok(None),
            other => T::from_json(other).map(Some),
        }
    }
}

impl<T: Value> Value for Box<T> {
    fn to_json(&self) -> Json {
        (**self).to_json()
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        T::from_json(json).map(Box::new)
    }
}

impl<T: Value> Value for Vec<T> {
    fn to_json(&self) -> Json {
        Json::List(self.iter().map(|item| item.to_json()).collect())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::List(items) => items.iter().map(T::from_json).collect(),
            other => expected("a list", other),
        }
    }
}

impl<T: Value> Value for BTreeMap<String, T> {
    fn to_json(&self) -> Json {
        Json::Map(self.iter().map(|(name, item)| (name.clone(), item.to_json())).collect())
    }
    fn from_json(json: &Json) -> Result<Self, Error> {
        match json {
            Json::Map(items) => items.iter().map(|(name, item)| Ok((name.clone(), T::from_json(item)?))).collect(),
            other => expected("a map", other),
        }
    }
}
