package rcp

import (
	"context"
	"errors"
	"sync"
	"time"
)

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
