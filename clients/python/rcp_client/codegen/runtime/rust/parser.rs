struct Parser<'a> {
    text: &'a [u8],
    at: usize,
    depth: usize,
}

impl<'a> Parser<'a> {
    fn fault(&self) -> Error {
        Error::local("bad_response", format!("no JSON at byte {}", self.at))
    }

    fn space(&mut self) {
        while self.at < self.text.len() && self.text[self.at].is_ascii_whitespace() {
            self.at += 1;
        }
    }

    fn take(&mut self, word: &str) -> bool {
        self.space();
        let there = self.text[self.at..].starts_with(word.as_bytes());
        if there {
            self.at += word.len();
        }
        there
    }

    fn value(&mut self) -> Result<Json, Error> {
        self.depth += 1;
        if self.depth > 128 {
            return Err(self.fault());
        }
        let value = if self.take("null") {
            Json::Null
        } else if self.take("true") {
            Json::Bool(true)
        } else if self.take("false") {
            Json::Bool(false)
        } else if self.take("\"") {
            Json::Text(self.string()?)
        } else if self.take("[") {
            let mut items = Vec::new();
            while !self.take("]") {
                if !items.is_empty() && !self.take(",") {
                    return Err(self.fault());
                }
                items.push(self.value()?);
            }
            Json::List(items)
        } else if self.take("{") {
            let mut items = BTreeMap::new();
            while !self.take("}") {
                if !items.is_empty() && !self.take(",") || !self.take("\"") {
                    return Err(self.fault());
                }
                let name = self.string()?;
                if !self.take(":") {
                    return Err(self.fault());
                }
                items.insert(name, self.value()?);
            }
            Json::Map(items)
        } else {
            self.number()?
        };
        self.depth -= 1;
        Ok(value)
    }

    fn number(&mut self) -> Result<Json, Error> {
        let begin = self.at;
        while self.at < self.text.len() && b"+-.0123456789eE".contains(&self.text[self.at]) {
            self.at += 1;
        }
        let text = std::str::from_utf8(&self.text[begin..self.at]).unwrap_or("");
        match (text.parse::<i64>(), text.parse::<f64>()) {
            (Ok(value), _) => Ok(Json::Int(value)),
            (_, Ok(value)) => Ok(Json::Float(value)),
            _ => Err(self.fault()),
        }
    }

    fn string(&mut self) -> Result<String, Error> {
        let mut made = Vec::new();
        loop {
            let letter = *self.text.get(self.at).ok_or_else(|| self.fault())?;
            self.at += 1;
            match letter {
                b'"' => return String::from_utf8(made).map_err(|_| self.fault()),
                b'\\' => {
                    let escaped = *self.text.get(self.at).ok_or_else(|| self.fault())?;
                    self.at += 1;
                    let letter = match escaped {
                        b'b' => '\u{8}',
                        b'f' => '\u{c}',
                        b'n' => '\n',
                        b'r' => '\r',
                        b't' => '\t',
                        b'u' => self.unicode()?,
                        other => other as char,
                    };
                    made.extend(letter.to_string().bytes());
                }
                letter => made.push(letter),
            }
        }
    }

    fn unicode(&mut self) -> Result<char, Error> {
        let first = self.hex()?;
        if (0xd800..0xdc00).contains(&first) && self.text[self.at..].starts_with(b"\\u") {
            self.at += 2;
            let second = self.hex()?;
            let code = 0x10000 + ((first - 0xd800) << 10) + second.wrapping_sub(0xdc00);
            return char::from_u32(code).ok_or_else(|| self.fault());
        }
        Ok(char::from_u32(first).unwrap_or('\u{fffd}'))
    }

    fn hex(&mut self) -> Result<u32, Error> {
        let digits = self.text.get(self.at..self.at + 4).ok_or_else(|| self.fault())?;
        self.at += 4;
        let text = std::str::from_utf8(digits).map_err(|_| self.fault())?;
        u32::from_str_radix(text, 16).map_err(|_| self.fault())
    }
}
