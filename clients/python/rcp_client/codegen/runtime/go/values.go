package rcp

import (
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
