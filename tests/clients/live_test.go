// What the generated client does with a real gateway when connections are cut. Copied beside the example's main.go.
package main

import (
	"bytes"
	"context"
	"encoding/json"
	"errors"
	"fmt"
	"io"
	"net/http"
	"net/http/httptest"
	"os"
	"sync/atomic"
	"testing"
	"time"

	"example/rcp"
)

const patience = time.Minute

var url, operator, admin = os.Getenv("RCP_URL"), os.Getenv("RCP_TOKEN"), os.Getenv("RCP_ADMIN")

func within(t *testing.T) context.Context {
	ctx, stop := context.WithTimeout(context.Background(), patience)
	t.Cleanup(stop)
	return ctx
}

func ask(t *testing.T, token, method, path string, body any, into any) {
	t.Helper()
	content, _ := json.Marshal(body)
	request, _ := http.NewRequest(method, url+"/rcp/v1"+path, bytes.NewReader(content))
	request.Header.Set("Authorization", "Bearer "+token)
	request.Header.Set("Content-Type", "application/json")
	response, err := http.DefaultClient.Do(request)
	if err != nil {
		t.Fatal(err)
	}
	defer response.Body.Close()
	data, _ := io.ReadAll(response.Body)
	if response.StatusCode >= 300 {
		t.Fatalf("%s %s: %s", method, path, data)
	}
	if into != nil {
		if err := json.Unmarshal(data, into); err != nil {
			t.Fatal(err)
		}
	}
}

// drives counts the commands that drove alpha.
func drives(t *testing.T) int {
	t.Helper()
	var listed struct {
		Body []struct {
			Path string `json:"path"`
		} `json:"body"`
	}
	ask(t, operator, "GET", "/commands?path=/tenant/alpha/action/move_to&limit=1000", nil, &listed)
	return len(listed.Body)
}

// between passes requests on to the gateway, and cuts the connection of the client where cut says so.
func between(t *testing.T, cut func(request *http.Request, sent int) bool) *rcp.Gateway {
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		body, _ := io.ReadAll(r.Body)
		passed, _ := http.NewRequestWithContext(r.Context(), r.Method, url+r.URL.String(), bytes.NewReader(body))
		passed.Header = r.Header
		response, err := http.DefaultClient.Do(passed)
		if err != nil {
			return
		}
		defer response.Body.Close()
		if cut(r, 0) {
			panic(http.ErrAbortHandler)
		}
		for name, values := range response.Header {
			w.Header()[name] = values
		}
		w.Header().Del("Content-Length")
		w.WriteHeader(response.StatusCode)
		piece := make([]byte, 1<<16)
		for sent := 1; ; sent++ {
			size, err := response.Body.Read(piece)
			if _, failed := w.Write(piece[:size]); err != nil || failed != nil {
				return
			}
			w.(http.Flusher).Flush()
			if cut(r, sent) {
				panic(http.ErrAbortHandler)
			}
		}
	}))
	t.Cleanup(server.Close)
	return rcp.New(server.URL, operator)
}

func TestACommandWhoseAnswerIsLostIsCarriedOutOnce(t *testing.T) {
	var posts atomic.Int32
	gateway := between(t, func(r *http.Request, sent int) bool {
		return r.Method == "POST" && sent == 0 && posts.Add(1) <= 2
	})
	before := drives(t)
	goal := rcp.MoveToIn{Position: rcp.GoalPointIn{X: 0.6, Y: 0.5}}
	if _, err := rcp.AlphaMoveTo.Execute(within(t), gateway, goal); err != nil {
		t.Fatal(err)
	}
	if posts.Load() != 3 || drives(t) != before+1 {
		t.Errorf("sent %d times, drove %d times", posts.Load(), drives(t)-before)
	}
}

func TestAProgramThatStartsAgainUnderItsKeyActsOnce(t *testing.T) {
	before := drives(t)
	goal := rcp.MoveToIn{Position: rcp.GoalPointIn{X: 0.5, Y: 0.5}}
	ctx := rcp.WithKey(within(t), fmt.Sprintf("order-%d", time.Now().UnixNano()))
	for run := 0; run < 2; run++ {
		if _, err := rcp.AlphaMoveTo.Execute(ctx, rcp.New(url, operator), goal); err != nil {
			t.Fatal(err)
		}
	}
	var refused *rcp.Error
	goal.Position.X = 0.7
	if _, err := rcp.AlphaMoveTo.Execute(ctx, rcp.New(url, operator), goal); !errors.As(err, &refused) || refused.Code != "duplicate_request" {
		t.Errorf("another command under the key: %v", err)
	}
	if drives(t) != before+1 {
		t.Errorf("drove %d times", drives(t)-before)
	}
}

func TestACommandThatNobodyWantsAnyMoreEndsThoughItsAnswerIsLost(t *testing.T) {
	ctx, end := context.WithCancel(within(t))
	var posts atomic.Int32
	gateway := between(t, func(r *http.Request, sent int) bool {
		if r.Method == "POST" && sent == 0 && posts.Add(1) == 1 {
			end()
			return true
		}
		return false
	})
	far := rcp.MoveToIn{Position: rcp.GoalPointIn{X: 2.5, Y: 0.5}, Speed: rcp.Some(rcp.Float(0.1))}
	var refused *rcp.Error
	if _, err := rcp.AlphaMoveTo.Execute(ctx, gateway, far); !errors.As(err, &refused) || refused.Code != "cancelled" {
		t.Errorf("ended: %v", err)
	}
	var listed struct {
		Body []any `json:"body"`
	}
	ask(t, operator, "GET", "/commands?status=running&path=/tenant/alpha/action/move_to", nil, &listed)
	if len(listed.Body) != 0 {
		t.Errorf("still running: %v", listed.Body)
	}
}

func TestAStreamThatIsCutGoesOnWithoutLoss(t *testing.T) {
	var cuts atomic.Int32
	gateway := between(t, func(r *http.Request, sent int) bool {
		return sent == 5 && cuts.Add(1) <= 2
	})
	var numbers []uint64
	lost := uint64(0)
	err := rcp.AlphaPose.Watch(within(t), gateway, 0, func(update rcp.Update[rcp.PoseStamped]) error {
		lost += update.Dropped // told of: a slow reader's
		if numbers = append(numbers, update.Seq); cuts.Load() >= 2 && len(numbers) > 40 {
			return enough
		}
		return nil
	})
	if !errors.Is(err, enough) {
		t.Fatal(err)
	}
	for at := 1; at < len(numbers); at++ {
		if numbers[at] <= numbers[at-1] {
			t.Fatalf("repeated: %v", numbers)
		}
	}
	if all := numbers[len(numbers)-1] - numbers[0] + 1; all != uint64(len(numbers))+lost {
		t.Errorf("lost without a word: %v, told %d", numbers, lost)
	}
}

func TestAStreamThatIsRefusedEndsWithTheReason(t *testing.T) {
	var refused *rcp.Error
	heard := func(rcp.Update[rcp.PoseStamped]) error { return nil }
	if err := rcp.AlphaPose.Watch(within(t), rcp.New(url, "wrong"), 0, heard); !errors.As(err, &refused) || refused.Code != "unauthenticated" {
		t.Errorf("ended: %v", err)
	}
}

func TestALeaseKeepsOthersOutIsRenewedAndIsLostAtAnEstop(t *testing.T) {
	ctx := within(t)
	mine, other := rcp.New(url, operator), rcp.New(url, admin)
	lease, err := rcp.Acquire(ctx, mine, "/tenant/alpha", 2*time.Second)
	if err != nil {
		t.Fatal(err)
	}
	var held struct {
		Body []struct{ Lease, Expires string } `json:"body"`
	}
	ask(t, operator, "GET", "/context/system/leases", nil, &held)
	first := held.Body[0].Expires
	var refused *rcp.Error
	if err := rcp.AlphaSpeedLimit.Write(ctx, other, 0.9, 0); !errors.As(err, &refused) || refused.Code != "lease_held" {
		t.Errorf("another may write: %v", err)
	}
	if err := rcp.AlphaSpeedLimit.Write(ctx, mine, 0.9, 0); err != nil {
		t.Error(err)
	}
	for held.Body[0].Expires == first {
		if ctx.Err() != nil {
			t.Fatal("it is not renewed")
		}
		time.Sleep(50 * time.Millisecond)
		ask(t, operator, "GET", "/context/system/leases", nil, &held)
	}
	if err := lease.Release(ctx); err != nil {
		t.Error(err)
	}
	if err := rcp.AlphaSpeedLimit.Write(ctx, other, 1, 0); err != nil {
		t.Error(err)
	}
	lease, err = rcp.Acquire(ctx, mine, "/tenant/alpha", 2*time.Second)
	if err != nil {
		t.Fatal(err)
	}
	ask(t, admin, "POST", "/context/system/estop?wait=30", map[string]string{"scope": "/tenant/alpha"}, nil)
	select {
	case <-lease.Context.Done():
	case <-ctx.Done():
		t.Error("nothing tells that the lease is lost")
	}
	if !errors.As(lease.Err(), &refused) || refused.Code != "lease_lost" {
		t.Errorf("lost: %v", lease.Err())
	}
	if err := lease.Release(ctx); err != nil {
		t.Error(err)
	}
	ask(t, admin, "POST", "/context/system/estop?wait=30", map[string]any{"scope": "/tenant/alpha", "reset": true}, nil)
}
