package rcp

import (
	"context"
	"errors"
	"time"
)

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
