// What Execute does when a context ends, or a connection, while the robot moves. Copied beside a generated rcp.go.
package rcp

import (
	"context"
	"encoding/json"
	"errors"
	"net/http"
	"net/http/httptest"
	"strings"
	"sync/atomic"
	"testing"
	"time"
)

const patience = 40 * time.Second

var drive = Command[any, string]{"/tenant/alpha/action/drive"}

func tell(w http.ResponseWriter, body any) { _ = json.NewEncoder(w).Encode(body) }

func state(w http.ResponseWriter, about map[string]any) {
	tell(w, map[string]any{"status": "completed", "body": about})
}

// cut answers with the beginning of a message.
func cut(w http.ResponseWriter) {
	connection, out, err := w.(http.Hijacker).Hijack()
	if err != nil {
		panic(err)
	}
	_, _ = out.WriteString("HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\n{")
	_ = out.Flush()
	_ = connection.Close()
}

func TestACommandIsCancelledWhenItsContextEndsBeforeItIsAccepted(t *testing.T) {
	ctx, end := context.WithCancel(context.Background())
	defer end()
	var cancelled, asked atomic.Int32
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		switch r.Method {
		case "POST":
			end()
			select {
			case <-r.Context().Done(): // the client hangs up: nobody could cancel what begins now
			case <-time.After(time.Second):
			}
			tell(w, map[string]any{"status": "accepted", "command": "cmd-1"})
		case "DELETE":
			if cancelled.Add(1) == 1 {
				cut(w)
				return
			}
			tell(w, map[string]any{"status": "completed"})
		default:
			asked.Add(1)
			state(w, map[string]any{"status": "cancelled", "error": map[string]any{"code": "cancelled"}})
		}
	}))
	defer server.Close()
	var refused *Error
	if _, err := drive.Execute(ctx, New(server.URL, ""), nil); !errors.As(err, &refused) || refused.Code != "cancelled" {
		t.Errorf("ended: %v", err)
	}
	if cancelled.Load() != 2 || asked.Load() != 1 {
		t.Errorf("cancelled %d times, asked %d times", cancelled.Load(), asked.Load())
	}
}

func TestACommandOfAContextThatHasEndedIsNotSent(t *testing.T) {
	ctx, end := context.WithCancel(context.Background())
	end()
	if _, err := drive.Execute(ctx, New("http://127.0.0.1:1", ""), nil); !errors.Is(err, context.Canceled) {
		t.Errorf("ended: %v", err)
	}
}

func TestATokenOrAKeyWithALineBreakIsRefusedAtOnce(t *testing.T) {
	var asked atomic.Int32
	server := httptest.NewServer(http.HandlerFunc(func(http.ResponseWriter, *http.Request) { asked.Add(1) }))
	defer server.Close()
	began := time.Now()
	for _, one := range [][2]string{{"key\n", ""}, {"", "order-1\r\nAuthorization: Bearer other"}} {
		var refused *Error
		_, err := drive.Execute(WithKey(context.Background(), one[1]), New(server.URL, one[0]), nil)
		if !errors.As(err, &refused) || refused.Code != "bad_request" {
			t.Errorf("ended: %v", err)
		}
	}
	if asked.Load() > 0 || time.Since(began) > stopping/2 {
		t.Errorf("it was asked %d times, in %v", asked.Load(), time.Since(began))
	}
}

func TestACommandIsFollowedThoughAConnectionIsLost(t *testing.T) {
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	var asked atomic.Int32
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		if r.Method == "POST" {
			tell(w, map[string]any{"status": "accepted", "command": "cmd-1"})
			return
		}
		switch asked.Add(1) {
		case 1:
			cut(w)
		case 2:
			tell(w, map[string]any{"error": map[string]any{"code": "rate_limited", "retryable": true}})
		default:
			state(w, map[string]any{"status": "completed", "body": "there"})
		}
	}))
	defer server.Close()
	if out, err := drive.Execute(ctx, New(server.URL, ""), nil); err != nil || out != "there" {
		t.Errorf("ended: %q, %v", out, err)
	}
}

func TestARefusalToTellIsTheEnd(t *testing.T) {
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		if r.Method == "POST" {
			tell(w, map[string]any{"status": "accepted", "command": "cmd-1"})
			return
		}
		tell(w, map[string]any{"error": map[string]any{"code": "forbidden"}})
	}))
	defer server.Close()
	var refused *Error
	if _, err := drive.Execute(ctx, New(server.URL, ""), nil); !errors.As(err, &refused) || refused.Code != "forbidden" {
		t.Errorf("ended: %v", err)
	}
}

var busy = map[string]any{"error": map[string]any{"code": "rate_limited", "retryable": true}}

func TestARefusalThatPassesIsNoneOnceAnAnswerWasLost(t *testing.T) {
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	var sent atomic.Int32
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		if r.Method != "POST" {
			state(w, map[string]any{"status": "completed", "body": "there"})
			return
		}
		switch sent.Add(1) {
		case 1:
			cut(w)
		case 2:
			tell(w, busy)
		default:
			tell(w, map[string]any{"status": "accepted", "command": "cmd-1"})
		}
	}))
	defer server.Close()
	if out, err := drive.Execute(ctx, New(server.URL, ""), nil); err != nil || out != "there" || sent.Load() != 3 {
		t.Errorf("ended: %q, %v, sent %d times", out, err, sent.Load())
	}
}

func TestARefusalOfWhatWasSentOnceAndTheEndOfACommandAreAnswers(t *testing.T) {
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	var sent atomic.Int32
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		switch sent.Add(1) {
		case 1:
			tell(w, busy)
		case 2:
			cut(w)
		default:
			late := map[string]any{"code": "deadline_exceeded", "retryable": true}
			tell(w, map[string]any{"status": "failed", "command": "cmd-1", "error": late})
		}
	}))
	defer server.Close()
	for _, code := range []string{"rate_limited", "deadline_exceeded"} {
		var refused *Error
		if _, err := drive.Execute(ctx, New(server.URL, ""), nil); !errors.As(err, &refused) || refused.Code != code {
			t.Errorf("ended: %v instead of %s", err, code)
		}
	}
	if sent.Load() != 3 {
		t.Errorf("sent %d times", sent.Load())
	}
}

func TestAWriteHasNoKeyButTheOneThatWasNamed(t *testing.T) {
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	var keys []string
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		keys = append(keys, r.Header.Get("Idempotency-Key"))
		tell(w, map[string]any{"status": "completed"})
	}))
	defer server.Close()
	speed := Writable[float64]{"/tenant/alpha/param/speed"}
	for _, under := range []context.Context{ctx, WithKey(ctx, "order-1")} {
		if err := speed.Write(under, New(server.URL, ""), 1, 0); err != nil {
			t.Error(err)
		}
	}
	if strings.Join(keys, "|") != "|order-1" {
		t.Errorf("keys: %q", keys)
	}
}

func TestARenewalThatHangsLeavesTimeForAnother(t *testing.T) {
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	var asked atomic.Int32
	again := make(chan struct{})
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		var body map[string]any
		_ = json.NewDecoder(r.Body).Decode(&body)
		if body["do"] == "renew" {
			switch asked.Add(1) {
			case 1:
				<-r.Context().Done() // when the client hangs up
				return
			case 2:
				close(again)
			}
		}
		tell(w, map[string]any{"status": "completed", "body": map[string]any{"lease": "lease-1"}})
	}))
	defer server.Close()
	lease, err := Acquire(ctx, New(server.URL, ""), "/tenant/alpha", 6*time.Second)
	if err != nil {
		t.Fatal(err)
	}
	select {
	case <-again:
	case <-lease.Context.Done():
		t.Errorf("lost: %v", lease.Err())
	}
	if err := lease.Release(ctx); err != nil {
		t.Error(err)
	}
}

// leases serves leases, and notes what it is asked to do.
func leases(did chan<- string, before func(do string, r *http.Request)) *httptest.Server {
	return httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		var asked struct{ Do string }
		_ = json.NewDecoder(r.Body).Decode(&asked)
		did <- asked.Do
		before(asked.Do, r)
		state(w, map[string]any{"lease": "lease-1"})
	}))
}

func TestALeaseIsLostWithItsTimeThoughARenewalIsUnderWay(t *testing.T) {
	did := make(chan string, 9)
	server := leases(did, func(do string, r *http.Request) {
		if do == "renew" {
			<-r.Context().Done()
		}
	})
	defer server.Close()
	lease, err := Acquire(context.Background(), New(server.URL, ""), "/tenant/alpha", 600*time.Millisecond)
	if err != nil {
		t.Fatal(err)
	}
	<-lease.Context.Done()
	if err := lease.Err(); err == nil || !strings.Contains(err.Error(), "expired") {
		t.Errorf("lost: %v", err)
	}
}

func TestALeaseIsGivenBackThoughTheContextHasEnded(t *testing.T) {
	did := make(chan string, 9)
	server := leases(did, func(string, *http.Request) {})
	defer server.Close()
	ctx, end := context.WithCancel(context.Background())
	lease, err := Acquire(ctx, New(server.URL, ""), "/tenant/alpha", time.Minute)
	if err != nil {
		t.Fatal(err)
	}
	end()
	if err := lease.Release(ctx); err != nil || <-did != "acquire" || <-did != "release" {
		t.Errorf("released: %v", err)
	}
}

func TestALeaseThatIsGrantedAsTheContextEndsIsGivenBack(t *testing.T) {
	did := make(chan string, 9)
	ctx, end := context.WithCancel(context.Background())
	server := leases(did, func(do string, _ *http.Request) {
		if do == "acquire" {
			end()
		}
	})
	defer server.Close()
	if _, err := Acquire(ctx, New(server.URL, ""), "/tenant/alpha", time.Minute); !errors.Is(err, context.Canceled) {
		t.Errorf("acquired: %v", err)
	}
	if <-did != "acquire" || <-did != "release" {
		t.Error("it is still held")
	}
}

func TestAcquireEndsWithItsContextAndGivesBackWhatIsGrantedLater(t *testing.T) {
	did, answered := make(chan string, 9), make(chan struct{})
	server := leases(did, func(do string, _ *http.Request) {
		if do == "acquire" {
			<-answered
		}
	})
	defer server.Close()
	ctx, end := context.WithTimeout(context.Background(), 50*time.Millisecond)
	defer end()
	began := time.Now()
	_, err := Acquire(ctx, New(server.URL, ""), "/tenant/alpha", time.Minute)
	if took := time.Since(began); !errors.Is(err, context.DeadlineExceeded) || took > attempt/2 {
		t.Errorf("acquired: %v after %v", err, took)
	}
	close(answered)
	if <-did != "acquire" || <-did != "release" {
		t.Error("it is still held")
	}
}

func TestReleaseEndsSoonAfterItsContext(t *testing.T) {
	did, answered := make(chan string, 9), make(chan struct{})
	server := leases(did, func(do string, _ *http.Request) {
		if do == "release" {
			<-answered
		}
	})
	defer server.Close()
	defer close(answered)
	ctx, end := context.WithTimeout(context.Background(), patience)
	defer end()
	lease, err := Acquire(ctx, New(server.URL, ""), "/tenant/alpha", time.Minute)
	if err != nil {
		t.Fatal(err)
	}
	end()
	began := time.Now()
	err = lease.Release(ctx)
	if took := time.Since(began); !errors.Is(err, context.Canceled) || took > attempt/2 {
		t.Errorf("released: %v after %v", err, took)
	}
	if <-did != "acquire" || <-did != "release" {
		t.Error("it was not given back")
	}
}

// proxied answers as a proxy that has lost its gateway.
func proxied(w http.ResponseWriter) {
	w.WriteHeader(http.StatusBadGateway)
	tell(w, map[string]any{"message": "no healthy upstream"})
}

func TestWhatNoGatewayAnsweredIsNotDone(t *testing.T) {
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) { proxied(w) }))
	defer server.Close()
	gateway, limit := New(server.URL, ""), "/tenant/alpha/param/limit"
	var refused *Error
	if err := (Writable[Float]{limit}).Write(context.Background(), gateway, 1, 0); err == nil || errors.As(err, &refused) {
		t.Errorf("written: %v", err)
	}
	if value, err := (Readable[Float]{limit}).Read(context.Background(), gateway); err == nil {
		t.Errorf("read: %v", value)
	}
	if held, err := Acquire(context.Background(), gateway, "/tenant/alpha", time.Second); err == nil {
		t.Errorf("held: %v", held)
	}
}

func TestALeaseThatIsNotGrantedYetIsNotHeld(t *testing.T) {
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		tell(w, map[string]any{"status": "accepted", "command": "cmd-1"})
	}))
	defer server.Close()
	if held, err := Acquire(context.Background(), New(server.URL, ""), "/tenant/alpha", time.Second); err == nil {
		t.Errorf("held: %v", held)
	}
}

func TestACommandIsCarriedOutThoughAProxyHadLostItsGateway(t *testing.T) {
	var sent atomic.Int32
	server := httptest.NewServer(http.HandlerFunc(func(w http.ResponseWriter, r *http.Request) {
		switch {
		case r.Method != "POST":
			state(w, map[string]any{"status": "completed", "body": "there"})
		case sent.Add(1) == 1:
			proxied(w)
		default:
			tell(w, map[string]any{"status": "accepted", "command": "cmd-1"})
		}
	}))
	defer server.Close()
	if out, err := drive.Execute(context.Background(), New(server.URL, ""), nil); err != nil || out != "there" {
		t.Errorf("ended: %q, %v", out, err)
	}
}
