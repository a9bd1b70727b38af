package rcp

import (
	"context"
	"errors"
	"sync"
	"time"
)

// farewell is how long a lease may be given back for a caller whose context has ended.
const farewell = time.Second

var errExpired = errors.New("the lease expired: it could not be renewed in time")

// Lease is exclusive control of a part of the tree, renewed until it is released or lost. It holds for everything
// that is sent with the same token.
type Lease struct {
	// Context ends when the lease is lost or released, and with its time at the latest: commands under it are then cancelled.
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

type leaseAnswer struct {
	state leaseState
	err   error
}

// Acquire takes a lease on a scope, such as /tenant/alpha/actuator. It lapses ttl after the last renewal that succeeded.
// A lease that is granted as ctx ends, or afterwards, is given back; Acquire waits at most a second for that.
func Acquire(ctx context.Context, g *Gateway, scope string, ttl time.Duration) (*Lease, error) {
	if err := ctx.Err(); err != nil {
		return nil, err
	}
	began := time.Now()
	answer := g.leaseAnyway(map[string]any{"do": "acquire", "scope": scope, "ttl": ttl.Seconds()})
	select {
	case found := <-answer:
		if found.err != nil {
			return nil, found.err
		}
		if ctx.Err() == nil {
			held := &Lease{gateway: g, ttl: ttl, state: found.state}
			held.Context, held.stop = context.WithCancel(ctx)
			held.renewed.Add(1)
			go held.keep(began.Add(ttl))
			return held, nil
		}
		answer <- found
	case <-ctx.Done():
	}
	g.giveBack(answer)
	return nil, ctx.Err()
}

// Err returns why the lease was lost, or nil.
func (l *Lease) Err() error {
	l.mutex.Lock()
	defer l.mutex.Unlock()
	return l.err
}

// Release gives the lease back, also if ctx has ended: others wait for it. It waits for the answer until a second
// after the end of ctx. A lease that is lost already is no error.
func (l *Lease) Release(ctx context.Context) error {
	l.stop()
	l.renewed.Wait()
	if l.Err() != nil {
		return nil
	}
	answer := l.gateway.release(l.state)
	select {
	case found := <-answer:
		return found.err
	case <-ctx.Done():
	}
	select {
	case found := <-answer:
		return found.err
	case <-time.After(farewell):
		return ctx.Err()
	}
}

// lose ends the lease, unless it has ended before.
func (l *Lease) lose(err error) {
	l.mutex.Lock()
	if l.err == nil && l.Context.Err() == nil {
		l.err = err
	}
	l.mutex.Unlock()
	l.stop()
}

func (l *Lease) keep(until time.Time) {
	defer l.renewed.Done()
	defer l.stop()
	// Its time may be over while a renewal is under way, or while this waits to try again.
	expiry := time.AfterFunc(time.Until(until), func() { l.lose(errExpired) })
	defer expiry.Stop()
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
		case l.Context.Err() != nil:
			return
		case err == nil:
			until = began.Add(l.ttl)
			if !expiry.Stop() {
				return
			}
			expiry.Reset(time.Until(until))
		case errors.As(err, &refused) && !refused.Retryable:
			l.lose(err)
			return
		}
	}
}

// leaseAnyway asks whatever becomes of the caller's context: an answer that nobody takes would leave the lease held.
func (g *Gateway) leaseAnyway(body map[string]any) chan leaseAnswer {
	answer := make(chan leaseAnswer, 1)
	go func() {
		within, stop := context.WithTimeout(context.Background(), attempt)
		defer stop()
		state, err := g.lease(within, body)
		answer <- leaseAnswer{state, err}
	}()
	return answer
}

func (g *Gateway) release(state leaseState) chan leaseAnswer {
	return g.leaseAnyway(map[string]any{"do": "release", "lease": state.Lease})
}

// giveBack releases what is still to be granted, in the background if that takes longer than a second.
func (g *Gateway) giveBack(answer <-chan leaseAnswer) {
	given := make(chan struct{})
	go func() {
		defer close(given)
		if found := <-answer; found.err == nil {
			<-g.release(found.state)
		}
	}()
	select {
	case <-given:
	case <-time.After(farewell):
	}
}

func (g *Gateway) lease(ctx context.Context, body map[string]any) (leaseState, error) {
	found, err := done(g.once(ctx, newKey(), "POST", "/context/system/leases?wait=10", body))
	if err != nil {
		return leaseState{}, err
	}
	return into[leaseState](found.Body)
}
