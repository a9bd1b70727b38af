package rcp

import (
	"bufio"
	"context"
	"errors"
	"net/http"
	"net/url"
	"strconv"
	"strings"
	"time"
)

// Readable is a path that can be read and watched.
type Readable[T any] struct{ path string }

// Read returns the current value.
func (r Readable[T]) Read(ctx context.Context, g *Gateway) (T, error) {
	found, err := done(g.ask(ctx, "GET", "/context"+r.path, nil))
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
		line, err := lines.ReadString('\n')
		if err != nil {
			return err
		}
		silent.Reset(silence)
		line = strings.TrimRight(line, "\r\n")
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
				if err := decode([]byte(data), &update); err != nil {
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
	_, err := done(g.once(ctx, keyOf(ctx), "PUT", path, value))
	return err
}

// Setting is a path that can be read, watched and written.
type Setting[R, W any] struct {
	Readable[R]
	Writable[W]
}
