// Integers beyond 2^53 at a real gateway. Copied beside a generated rcp.go.
package rcp

import (
	"context"
	"encoding/json"
	"errors"
	"math"
	"os"
	"reflect"
	"testing"
	"time"
)

var enough = errors.New("enough")

func TestWideIntegersComeAndGoAsTheyAre(t *testing.T) {
	ctx, stop := context.WithTimeout(context.Background(), time.Minute)
	defer stop()
	gateway := New(os.Getenv("RCP_URL"), "")
	// Of any type, the gateway writes a wide one as its digits; a number keeps its own.
	loose := map[string]any{"n": []any{"9007199254740993", json.Number("5"), json.Number("5.0"), "5"}}
	expected := Parcel{I64: math.MinInt64, U64: math.MaxUint64, Small: 5, Any: loose}
	read, err := AlphaParcel.Read(ctx, gateway)
	if err != nil || !reflect.DeepEqual(read, expected) {
		t.Errorf("read: %#v, %v", read, err)
	}
	err = AlphaParcel.Watch(ctx, gateway, 0, func(update Update[Parcel]) error {
		if !reflect.DeepEqual(update.Body, expected) {
			t.Errorf("heard: %#v", update.Body)
		}
		return enough
	})
	if err != enough {
		t.Error(err)
	}
	loose["n"].([]any)[0] = int64(1<<53 + 1)
	written := Parcel{I64: math.MaxInt64, U64: 1 << 63, Small: -5, Any: loose}
	if err := AlphaParcel.Write(ctx, gateway, written, 0); err != nil {
		t.Error(err)
	}
}

func TestWhatIsNoIntegerOrTooLargeIsAnError(t *testing.T) {
	var signed Int
	var unsigned Uint
	for _, text := range []string{`"9223372036854775808"`, `1.5`, `"ten"`} {
		if json.Unmarshal([]byte(text), &signed) == nil {
			t.Errorf("%s is %d", text, signed)
		}
	}
	if json.Unmarshal([]byte(`-1`), &unsigned) == nil {
		t.Errorf("-1 is %d", unsigned)
	}
}
