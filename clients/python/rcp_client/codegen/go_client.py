"""The part of the Go output that is the same for every gateway."""

from __future__ import annotations

__all__ = ["CLIENT", "HEAD", "RESERVED"]

RESERVED = ("Gateway", "New", "Error", "Float", "Readable", "Writable", "Setting", "Command", "Update",
            "Some", "Lease", "Acquire", "WithKey")  # fmt: skip
"""Names that no type of a gateway may have."""

HEAD = """
// Typed client of the gateway at URL, written by `rcpctl codegen --lang go`.
//
//	gateway := rcp.New("URL", token)
//	pose, err := rcp.AlphaSensorPose.Read(ctx, gateway)

package rcp

import (
	"bufio"
	"bytes"
	"context"
	"crypto/rand"
	"encoding/hex"
	"encoding/json"
	"errors"
	"fmt"
	"io"
	"math"
	"net/http"
	"net/url"
	"strconv"
	"strings"
	"sync"
	"time"
)
"""

CLIENT = """
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

// Error is what the gateway refused or failed to do.
type Error struct {
	Code      string `json:"code"`
	Message   string `json:"message"`
	Remedy    string `json:"remedy"`
	Retryable bool   `json:"retryable"`
}

func (e *Error) Error() string { return fmt.Sprintf("%s: %s", e.Code, e.Message) }

// Gateway is a gateway, over HTTP and server-sent events.
type Gateway struct {
	// Client sends the requests; its Transport has what is needed for TLS.
	Client *http.Client
	base   string
	token  string
}

// New returns a gateway; nothing is sent yet. The token may be empty.
func New(url, token string) *Gateway {
	return &Gateway{http.DefaultClient, strings.TrimRight(url, "/") + "/rcp/v1", token}
}

type reply struct {
	Status  string          `json:"status"`
	Command string          `json:"command"`
	Body    json.RawMessage `json:"body"`
	Error   *Error          `json:"error"`
}

type keyed struct{}

// WithKey names what is written or executed under the context. The gateway acts once for a key, also when the same
// is sent again after a lost connection, or by a program that was started again, and answers with the first outcome.
func WithKey(ctx context.Context, key string) context.Context {
	return context.WithValue(ctx, keyed{}, key)
}

// keyOf returns the key of a context, or "".
func keyOf(ctx context.Context) string {
	key, _ := ctx.Value(keyed{}).(string)
	return key
}

func newKey() string {
	random := make([]byte, 16)
	if _, err := rand.Read(random); err != nil {
		panic(err)
	}
	return hex.EncodeToString(random)
}

func (g *Gateway) open(ctx context.Context, method, path string, body any) (*http.Response, error) {
	return g.openAs(ctx, method, path, body, nil)
}

func (g *Gateway) openAs(ctx context.Context, method, path string, body any, header map[string]string) (*http.Response, error) {
	var content io.Reader
	if body != nil {
		data, err := json.Marshal(body)
		if err != nil {
			return nil, err
		}
		content = bytes.NewReader(data)
	}
	request, err := http.NewRequestWithContext(ctx, method, g.base+path, content)
	if err != nil {
		return nil, err
	}
	if body != nil {
		request.Header.Set("Content-Type", "application/json")
	}
	if g.token != "" {
		request.Header.Set("Authorization", "Bearer "+g.token)
	}
	for name, value := range header {
		request.Header.Set(name, value)
	}
	return g.Client.Do(request)
}

func decoded(response *http.Response) (reply, error) {
	var found reply
	if err := json.NewDecoder(response.Body).Decode(&found); err != nil {
		return found, fmt.Errorf("HTTP %d: %w", response.StatusCode, err)
	}
	if found.Error != nil {
		return found, found.Error
	}
	return found, nil
}

func (g *Gateway) ask(ctx context.Context, method, path string, body any) (reply, error) {
	return g.askAs(ctx, method, path, body, nil)
}

// once sends what acts, under a key if there is one; net/http itself may send that again.
func (g *Gateway) once(ctx context.Context, key, method, path string, body any) (reply, error) {
	if key == "" {
		return g.ask(ctx, method, path, body)
	}
	return g.askAs(ctx, method, path, body, map[string]string{"Idempotency-Key": key})
}

func (g *Gateway) askAs(ctx context.Context, method, path string, body any, header map[string]string) (reply, error) {
	response, err := g.openAs(ctx, method, path, body, header)
	if err != nil {
		return reply{}, err
	}
	defer response.Body.Close()
	return decoded(response)
}

func into[T any](body json.RawMessage) (T, error) {
	var value T
	if len(body) == 0 {
		return value, nil
	}
	err := json.Unmarshal(body, &value)
	return value, err
}

// Readable is a path that can be read and watched.
type Readable[T any] struct{ path string }

// Read returns the current value.
func (r Readable[T]) Read(ctx context.Context, g *Gateway) (T, error) {
	found, err := g.ask(ctx, "GET", "/context"+r.path, nil)
	if err != nil {
		var none T
		return none, err
	}
	return into[T](found.Body)
}

// Update is one sample of a watched path.
type Update[T any] struct {
	Path      string    `json:"path"`
	Seq       uint64    `json:"seq"`
	Timestamp time.Time `json:"timestamp"`
	Body      T         `json:"body"`
	Dropped   uint64    `json:"dropped"`
}

// Watch calls heard with each new value, until that returns an error or ctx ends; rate is in Hz, 0 for all.
// A stream that is lost is opened again, and goes on after the last value that was heard.
func (r Readable[T]) Watch(ctx context.Context, g *Gateway, rate float64, heard func(Update[T]) error) error {
	query := url.Values{"path": {r.path}}
	if rate > 0 {
		query.Set("rate", strconv.FormatFloat(rate, 'g', -1, 64))
	}
	last := ""
	for pause := firstPause; ; pause = longer(pause) {
		before := last
		err := r.stream(ctx, g, query, &last, heard)
		var stopped *halt
		var refused *Error
		switch {
		case errors.As(err, &stopped):
			return stopped.error
		case ctx.Err() != nil:
			return ctx.Err()
		case errors.As(err, &refused) && !refused.Retryable:
			return err
		case last != before:
			pause = firstPause
		}
		select {
		case <-ctx.Done():
			return ctx.Err()
		case <-time.After(pause):
		}
	}
}

// halt wraps what the caller of Watch returned, to be told from what the stream met.
type halt struct{ error }

// stream carries one response; last is the id of the last event.
func (r Readable[T]) stream(ctx context.Context, g *Gateway, query url.Values, last *string, heard func(Update[T]) error) error {
	ctx, stop := context.WithCancel(ctx)
	defer stop()
	silent := time.AfterFunc(silence, stop)
	defer silent.Stop()
	header := map[string]string{}
	if *last != "" {
		header["Last-Event-ID"] = *last
	}
	response, err := g.openAs(ctx, "GET", "/events?"+query.Encode(), nil, header)
	if err != nil {
		return err
	}
	defer response.Body.Close()
	if response.StatusCode != http.StatusOK {
		_, err := decoded(response)
		return err
	}
	lines, event, id, data := bufio.NewReader(response.Body), "", "", ""
	for {
		line, err := lines.ReadString('\\n')
		if err != nil {
			return err
		}
		silent.Reset(silence)
		line = strings.TrimRight(line, "\\r\\n")
		switch {
		case strings.HasPrefix(line, "event: "):
			event = line[len("event: "):]
		case strings.HasPrefix(line, "id: "):
			id = line[len("id: "):]
		case strings.HasPrefix(line, "data: "):
			data += line[len("data: "):]
		case line == "":
			if event == "update" {
				var update Update[T]
				if err := json.Unmarshal([]byte(data), &update); err != nil {
					return &halt{err}
				}
				if err := heard(update); err != nil {
					return &halt{err}
				}
			}
			if id != "" {
				*last = id
			}
			event, data = "", ""
		}
	}
}

func longer(pause time.Duration) time.Duration {
	if pause *= 2; pause < longestPause {
		return pause
	}
	return longestPause
}

// Writable is a path that can be written.
type Writable[T any] struct{ path string }

// Write sets a value. If validFor is not 0, the gateway stops the robot unless the value is written again in that time.
// It is sent once: after an error that is not an *Error, the value may be in force.
func (w Writable[T]) Write(ctx context.Context, g *Gateway, value T, validFor time.Duration) error {
	path := "/context" + w.path
	if validFor > 0 {
		path += "?valid_for=" + strconv.FormatFloat(validFor.Seconds(), 'g', -1, 64)
	}
	_, err := g.once(ctx, keyOf(ctx), "PUT", path, value)
	return err
}

// Setting is a path that can be read, watched and written.
type Setting[R, W any] struct {
	Readable[R]
	Writable[W]
}

// Command is an action or a service.
type Command[In, Out any] struct{ path string }

const (
	poll         = 200 * time.Millisecond
	attempt      = 10 * time.Second
	stopping     = 30 * time.Second
	silence      = 45 * time.Second // the gateway sends a comment every 15 s
	firstPause   = 250 * time.Millisecond
	longestPause = 5 * time.Second
)

// Execute carries the command out and returns its result. When ctx ends the command is cancelled, and Execute
// returns once the robot has ended it. A connection that is lost meanwhile is tried again for 30 s; the command is
// sent again under the same key, so that it is carried out once.
func (c Command[In, Out]) Execute(ctx context.Context, g *Gateway, input In) (Out, error) {
	var none Out
	if err := ctx.Err(); err != nil {
		return none, err
	}
	found, err := g.begin(ctx, "/context"+c.path, input)
	if err != nil {
		return none, err
	}
	at := "/commands/" + found.Command
	found, err = g.follow(ctx, at, found)
	if err != nil && ctx.Err() != nil && !final(found.Status) {
		rest, stop := context.WithTimeout(context.Background(), stopping)
		defer stop()
		if _, err := g.insist(rest, "DELETE", at); err != nil {
			return none, err
		}
		found, err = g.follow(rest, at, found)
	}
	if err != nil {
		return none, err
	}
	return into[Out](found.Body)
}

// begin sends a command, again while no answer comes. Once an answer was lost, a refusal that passes is none: the
// robot may be moving. Not under ctx: what was sent may be under way, and can only be cancelled by the id in the
// answer.
func (g *Gateway) begin(ctx context.Context, path string, input any) (reply, error) {
	key := keyOf(ctx)
	if key == "" {
		key = newKey()
	}
	var lost error
	for end := time.Now().Add(stopping); ; {
		at := path
		if ctx.Err() != nil {
			at += "?deadline=0.001" // nobody wants it any more: if it is not under way, it is not to begin
		}
		sent, stop := context.WithTimeout(context.Background(), attempt)
		found, err := g.once(sent, key, "POST", at, input)
		stop()
		var refused *Error
		if !errors.As(err, &refused) {
			lost = err
		} else if lost == nil || !refused.Retryable || found.Command != "" {
			return found, err
		}
		if err == nil || time.Now().After(end) {
			return found, lost
		}
		time.Sleep(poll)
	}
}

// follow returns the last state of a command, or the one before ctx ended.
func (g *Gateway) follow(ctx context.Context, at string, found reply) (reply, error) {
	for !final(found.Status) {
		select {
		case <-ctx.Done():
			return found, ctx.Err()
		case <-time.After(poll):
		}
		about, err := g.insist(ctx, "GET", at)
		if err != nil {
			return found, err
		}
		if found, err = into[reply](about.Body); err != nil {
			return found, err
		}
	}
	if found.Error != nil {
		return found, found.Error
	}
	return found, nil
}

// insist asks again while no answer comes.
func (g *Gateway) insist(ctx context.Context, method, path string) (reply, error) {
	for end := time.Now().Add(stopping); ; {
		once, stop := context.WithTimeout(ctx, attempt)
		found, err := g.ask(once, method, path, nil)
		stop()
		var refused *Error
		if err == nil || errors.As(err, &refused) && !refused.Retryable || time.Now().After(end) {
			return found, err
		}
		select {
		case <-ctx.Done():
			return found, err
		case <-time.After(poll):
		}
	}
}

func final(status string) bool {
	return status == "completed" || status == "failed" || status == "rejected" || status == "cancelled"
}

// Lease is exclusive control of a part of the tree, renewed until it is released or lost. It holds for everything
// that is sent with the same token.
type Lease struct {
	// Context ends when the lease is lost or released: commands under it are then cancelled.
	Context context.Context

	gateway *Gateway
	ttl     time.Duration
	stop    context.CancelFunc
	renewed sync.WaitGroup
	mutex   sync.Mutex
	state   leaseState
	err     error
}

type leaseState struct {
	Lease  string `json:"lease"`
	Holder string `json:"holder"`
}

// Acquire takes a lease on a scope, such as /tenant/alpha/actuator. It lapses ttl after the last renewal that succeeded.
func Acquire(ctx context.Context, g *Gateway, scope string, ttl time.Duration) (*Lease, error) {
	within, stop := context.WithTimeout(ctx, attempt)
	defer stop()
	began := time.Now()
	state, err := g.lease(within, map[string]any{"do": "acquire", "scope": scope, "ttl": ttl.Seconds()})
	if err != nil {
		return nil, err
	}
	held := &Lease{gateway: g, ttl: ttl, state: state}
	held.Context, held.stop = context.WithCancel(ctx)
	held.renewed.Add(1)
	go held.keep(began.Add(ttl))
	return held, nil
}

// Err returns why the lease was lost, or nil.
func (l *Lease) Err() error {
	l.mutex.Lock()
	defer l.mutex.Unlock()
	return l.err
}

// Release gives the lease back. One that is lost already is no error.
func (l *Lease) Release(ctx context.Context) error {
	l.stop()
	l.renewed.Wait()
	if l.Err() != nil {
		return nil
	}
	_, err := l.gateway.lease(ctx, map[string]any{"do": "release", "lease": l.state.Lease})
	return err
}

func (l *Lease) keep(until time.Time) {
	defer l.renewed.Done()
	defer l.stop()
	for {
		select {
		case <-l.Context.Done():
			return
		case <-time.After(time.Until(until)/3 + poll):
		}
		began := time.Now()
		once, stop := context.WithTimeout(l.Context, time.Until(until)/2) // one that hangs leaves time for another
		_, err := l.gateway.lease(once, map[string]any{"do": "renew", "lease": l.state.Lease, "ttl": l.ttl.Seconds()})
		stop()
		var refused *Error
		switch {
		case err == nil:
			until = began.Add(l.ttl)
		case l.Context.Err() != nil:
			return
		case errors.As(err, &refused) && !refused.Retryable, time.Now().After(until):
			l.mutex.Lock()
			l.err = err
			l.mutex.Unlock()
			return
		}
	}
}

func (g *Gateway) lease(ctx context.Context, body map[string]any) (leaseState, error) {
	found, err := g.once(ctx, newKey(), "POST", "/context/system/leases?wait=10", body)
	if err != nil {
		return leaseState{}, err
	}
	return into[leaseState](found.Body)
}
"""
