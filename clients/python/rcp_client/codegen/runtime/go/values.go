package rcp

import (
	"bytes"
	"encoding/json"
	"math"
	"strconv"
	"strings"
)

// Some returns a pointer to a value, for fields that may be left out.
func Some[T any](value T) *T { return &value }

// Float is a number; those that JSON cannot write come as text.
type Float float64

// UnmarshalJSON reads a number, or "NaN", "Infinity" and "-Infinity".
func (f *Float) UnmarshalJSON(data []byte) error {
	value, err := strconv.ParseFloat(strings.Trim(string(data), `"`), 64)
	*f = Float(value)
	return err
}

// MarshalJSON writes a number, or its name.
func (f Float) MarshalJSON() ([]byte, error) {
	switch value := float64(f); {
	case math.IsNaN(value):
		return []byte(`"NaN"`), nil
	case math.IsInf(value, 1):
		return []byte(`"Infinity"`), nil
	case math.IsInf(value, -1):
		return []byte(`"-Infinity"`), nil
	default:
		return json.Marshal(value)
	}
}

// Int is an integer that may be beyond those that JSON numbers carry exactly; such ones come and go as their digits.
type Int int64

// UnmarshalJSON reads a number or its digits.
func (i *Int) UnmarshalJSON(data []byte) error {
	value, err := strconv.ParseInt(strings.Trim(string(data), `"`), 10, 64)
	*i = Int(value)
	return err
}

// MarshalJSON writes a number, or its digits.
func (i Int) MarshalJSON() ([]byte, error) {
	return exact(strconv.FormatInt(int64(i), 10), -safe <= i && i <= safe), nil
}

// Uint is an Int from 0.
type Uint uint64

// UnmarshalJSON reads a number or its digits.
func (u *Uint) UnmarshalJSON(data []byte) error {
	value, err := strconv.ParseUint(strings.Trim(string(data), `"`), 10, 64)
	*u = Uint(value)
	return err
}

// MarshalJSON writes a number, or its digits.
func (u Uint) MarshalJSON() ([]byte, error) {
	return exact(strconv.FormatUint(uint64(u), 10), u <= safe), nil
}

const safe = 1<<53 - 1

func exact(digits string, isSafe bool) []byte {
	if isSafe {
		return []byte(digits)
	}
	return []byte(`"` + digits + `"`)
}

// decode reads a value; a number of any type is a json.Number, with all its digits.
func decode(data []byte, value any) error {
	decoder := json.NewDecoder(bytes.NewReader(data))
	decoder.UseNumber()
	return decoder.Decode(value)
}
